"""Sound and captions beside a stream's segments: which stream may get some, what goes along with a
copy; adding, removing, reading and checking captions."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from codec.errors import CodecError, InvalidError
from codec.files import read_bounded, write_atomic
from codec.outputlock import writing_alone
from codec.storage.openstorage import Place, open_storage
from codec.stream.captions import MAX_CAPTIONS_BYTES, Captions, parse_webvtt
from codec.stream.manifest import MANIFEST_NAME, Manifest, object_file, object_name
from codec.stream.packedlayout import PACKED_SUFFIX
from codec.stream.reader import StreamReader, read_stream_file
from codec.stream.sound import MAX_SOUND_BYTES

Cut = tuple[StreamReader, range]
"""A range of frames of a stream."""


def finished(stream: Path) -> StreamReader:
    """The stream in the folder `stream`, if it may be changed. Raises a SwingsError."""
    if stream.name.endswith(PACKED_SUFFIX) and not stream.is_dir():
        raise InvalidError(f"{stream} is one file; unpack it first: swings-stream unpack")
    reader = StreamReader(stream, max_gaussians=None)
    if reader.manifest.live or not reader.records:
        raise InvalidError(f"{stream} is live or has no frames; add to it when it is finished")
    return reader


def copy_tracks(reader: StreamReader, folder: Path) -> None:
    """Copies the objects of sound and the captions of the stream of `reader` to `folder`, which has
    the folders of its segments. Raises a CodecError."""
    for source in reader.manifest.sound:
        for record in reader.records:
            path = object_name(record.segment, source.part)
            data = read_stream_file(reader.storage, path, MAX_SOUND_BYTES)
            write_atomic(object_file(folder, record.segment, source.part), data)
    for captions in reader.manifest.captions:
        data = read_stream_file(reader.storage, captions.file_name, MAX_CAPTIONS_BYTES)
        write_atomic(folder / captions.file_name, data)


def add_captions(stream: Path, file: Path, captions: Captions) -> int:
    """Adds the WebVTT file `file` as `captions`, in place of those of the same language; gives the
    number of its cues. The file comes first, then the manifest; a file of another name that it
    replaces goes last. Raises a SwingsError."""
    with writing_alone(stream):
        manifest = finished(stream).manifest
        if not file.is_file():
            raise InvalidError(f"{file} is not a file; name one with WebVTT")
        data = read_bounded(file, MAX_CAPTIONS_BYTES)
        try:
            cues = parse_webvtt(data)
        except CodecError as error:
            raise error.within(file) from error
        kept = tuple(each for each in manifest.captions if not each.is_in(captions.language))
        described = replace(manifest, captions=(*kept, captions)).to_json()
        path = stream / captions.file_name
        write_atomic(path, data)
        write_atomic(stream / MANIFEST_NAME, described)
        for each in manifest.captions:
            old = stream / each.file_name
            # Where file names have no case, it is the same file.
            if each not in kept and old.exists() and not old.samefile(path):
                old.unlink()
        return len(cues)


def remove_captions(stream: Path, language: str) -> None:
    """Removes the captions in `language`: from the manifest, then the file. Raises a
    SwingsError."""
    with writing_alone(stream):
        manifest = finished(stream).manifest
        left = tuple(each for each in manifest.captions if not each.is_in(language))
        if left == manifest.captions:
            there = ", ".join(each.language for each in manifest.captions) or "none"
            raise InvalidError(
                f"no captions have the language {language[:40]!a}; there are: {there}"
            )
        gone = next(each for each in manifest.captions if each.is_in(language))
        write_atomic(stream / MANIFEST_NAME, replace(manifest, captions=left).to_json())
        (stream / gone.file_name).unlink(missing_ok=True)


def read_captions(place: Place, captions: Captions) -> bytes:
    """The file of `captions` of the stream at `place`, checked. Raises a CodecError that names
    it."""
    storage = open_storage(place)
    data = read_stream_file(storage, captions.file_name, MAX_CAPTIONS_BYTES)
    try:
        parse_webvtt(data)
    except CodecError as error:
        raise error.within(storage.place(captions.file_name)) from error
    return data


def verify_captions(place: Place, manifest: Manifest) -> None:
    """Reads all captions. Raises a CodecError for the first that are wrong."""
    for captions in manifest.captions:
        read_captions(place, captions)
