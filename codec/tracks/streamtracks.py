"""Sound and captions of a finished stream: adding, removing, reading, checking them, and copying
them along with an edit.
"""

from __future__ import annotations

import wave
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from codec.errors import CodecError, CorruptError, InvalidError
from codec.files import read_bounded, replacing, write_atomic
from codec.outputlock import writing_alone
from codec.storage.openstorage import Place, open_storage
from codec.stream.captions import MAX_CAPTIONS_BYTES, Captions, parse_webvtt
from codec.stream.manifest import MANIFEST_NAME, SEGMENTS_NAME, Manifest, object_file, object_name
from codec.stream.packedlayout import PACKED_SUFFIX
from codec.stream.reader import StreamReader, read_stream_file
from codec.stream.segment import SegmentRecord
from codec.stream.sound import (
    DEFAULT_BITRATE_BPS,
    MAX_SOUND_BYTES,
    SAMPLE_RATE,
    SoundObject,
    SoundSource,
    checked_object,
    first_sample,
    packet_samples,
    segment_sound,
)

from .soundfile import Samples, decode, encode, read_samples, shifted

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


MAX_OFFSET_S = 1e6


def _span(record: SegmentRecord, fps: float) -> tuple[int, int]:
    """The range of samples heard with a segment: the first one, and the one after the last."""
    first = record.first_frame
    return first_sample(first, fps), first_sample(first + record.num_frames, fps)


def add_sound(
    stream: Path,
    file: Path,
    source: SoundSource,
    bitrate_bps: int = DEFAULT_BITRATE_BPS,
    offset_s: float = 0.0,
) -> int:
    """Adds the sound in `file` as `source`, from second `offset_s` on, as far as the stream goes;
    gives the bytes of its objects. The objects come first, the manifest last. Raises a
    SwingsError."""
    if not abs(offset_s) <= MAX_OFFSET_S:
        raise InvalidError(f"an offset of {offset_s} s is out of range; at most {MAX_OFFSET_S}")
    with writing_alone(stream):
        pieces = shifted(read_samples(file, source.channels), source.channels, offset_s)
        reader = finished(stream)
        manifest = _with_source(reader.manifest, source)
        described = manifest.to_json()
        size = _write(stream, reader.records, manifest.fps, pieces, source, bitrate_bps)
        write_atomic(stream / MANIFEST_NAME, described)
        return size


def _with_source(manifest: Manifest, source: SoundSource) -> Manifest:
    return replace(manifest, sound=(*manifest.sound, source))


def _write(
    folder: Path,
    records: Sequence[SegmentRecord],
    fps: float,
    pieces: Iterable[Samples],
    source: SoundSource,
    bitrate_bps: int = DEFAULT_BITRATE_BPS,
) -> int:
    """Writes the objects of `source`, whose samples are `pieces`, beside those of all segments;
    gives their bytes."""
    _, length = _span(records[-1], fps)
    whole = encode(pieces, source.channels, length, bitrate_bps)
    objects = [segment_sound(whole, *_span(record, fps)).pack() for record in records]
    for record, data in zip(records, objects, strict=True):
        write_atomic(object_file(folder, record.segment, source.part), data)
    return sum(map(len, objects))


def find_source(manifest: Manifest, name: str) -> SoundSource:
    """The source called `name`. Raises InvalidError."""
    for source in manifest.sound:
        if source.name == name:
            return source
    there = ", ".join(source.name for source in manifest.sound) or "none"
    raise InvalidError(f"no sound is called {name[:40]!a}; there are: {there}")


def remove_sound(stream: Path, name: str) -> None:
    """Removes the source `name`: from the manifest, then its objects. Raises a SwingsError."""
    with writing_alone(stream):
        reader = finished(stream)
        gone = find_source(reader.manifest, name)
        left = tuple(source for source in reader.manifest.sound if source != gone)
        write_atomic(stream / MANIFEST_NAME, replace(reader.manifest, sound=left).to_json())
        for segment in range(len(reader.records)):
            object_file(stream, segment, gone.part).unlink(missing_ok=True)


def read_sound(reader: StreamReader, segment: int, source: SoundSource) -> SoundObject:
    """The object of (segment, source), checked. Raises a CodecError that names it."""
    path = f"{SEGMENTS_NAME}/{segment}/{source.part}"
    data = read_stream_file(reader.storage, path, MAX_SOUND_BYTES)
    try:
        return checked_object(data, source, *_span(reader.records[segment], reader.manifest.fps))
    except CodecError as error:
        raise error.within(reader.storage.place(path)) from error


def _packets(reader: StreamReader, source: SoundSource) -> Iterator[bytes]:
    """The packets of all segments, each once, from position 0 on."""
    end = 0
    for segment in range(len(reader.records)):
        found = read_sound(reader, segment, source)
        at = found.first
        for packet in found.packets:
            if at == end:
                yield packet
                end += packet_samples(packet)
            at += packet_samples(packet)


def samples(reader: StreamReader, source: SoundSource) -> Iterator[Samples]:
    """The samples of `source` from frame 0 on, its whole length as far as there are frames, piece
    by piece. Raises a CodecError."""
    head = read_sound(reader, 0, source)
    length = min(head.num_samples, first_sample(reader.num_frames, reader.manifest.fps))
    at = -head.pre_skip
    for piece in decode(_packets(reader, source), source.channels):
        chosen = piece[max(0, -at) : max(0, length - at)]
        at += len(piece)
        if len(chosen):
            yield chosen
    if at < length:
        raise CorruptError(f"{reader.name}: sound {source.name} ends at sample {at}")


def extract_sound(stream: str, out: Path, name: str) -> int:
    """Writes the source `name` as a WAV file of 16 bits; gives its samples. Raises a
    SwingsError."""
    if out.suffix.lower() != ".wav":
        raise InvalidError(f"{out} cannot be written; name a file that ends with .wav")
    reader = StreamReader(stream, max_gaussians=None)
    source, count = find_source(reader.manifest, name), 0
    with writing_alone(out), replacing(out) as temporary, wave.open(str(temporary), "wb") as file:
        file.setnchannels(source.channels)
        file.setsampwidth(2)
        file.setframerate(SAMPLE_RATE)
        for piece in samples(reader, source):
            file.writeframes(piece.astype("<i2").tobytes())
            count += len(piece)
    return count


def verify_sound(reader: StreamReader) -> None:
    """Reads and decodes all sound. Raises a CodecError for the first thing that is wrong."""
    for source in reader.manifest.sound if reader.records else ():
        for _ in samples(reader, source):
            pass


def add_cuts(
    folder: Path, manifest: Manifest, records: Sequence[SegmentRecord], cuts: Sequence[Cut]
) -> tuple[Manifest, list[str]]:
    """Adds the sound of `cuts`, joined in this order and encoded again, to the stream in `folder`.
    Gives its manifest with them, and the names of sources that are left out: with several cuts,
    those that move, or differ in place or channels. Raises a SwingsError."""
    names = dict.fromkeys(one.name for reader, _ in cuts for one in reader.manifest.sound)
    left_out = []
    for name in names:
        found = [_named(reader.manifest, name) for reader, _ in cuts]
        source = _joined([one for one in found if one is not None], cuts[0])
        if source is None:
            left_out.append(name)
            continue
        pieces = _cut_samples(cuts, found, source.channels)
        _write(folder, records, manifest.fps, pieces, source)
        manifest = _with_source(manifest, source)
    return manifest, left_out


def _named(manifest: Manifest, name: str) -> SoundSource | None:
    return next((one for one in manifest.sound if one.name == name), None)


def _joined(sources: Sequence[SoundSource], first: Cut) -> SoundSource | None:
    """The source that all of `sources` agree on; None if they differ. first: the first cut."""
    one = sources[0]
    if len(sources) > 1 or not any(one is own for own in first[0].manifest.sound):
        alike = all((each.keys, each.channels) == (one.keys, one.channels) for each in sources)
        return one if alike and len(one.keys) <= 1 else None
    reader, frames = first
    begin_s = frames.start / reader.manifest.fps
    return replace(one, keys=tuple((time_s - begin_s, x, y, z) for time_s, x, y, z in one.keys))


def _cut_samples(
    cuts: Sequence[Cut], sources: Sequence[SoundSource | None], channels: int
) -> Iterator[Samples]:
    """The samples of all cuts, with silence where a source has none."""
    done = 0  # frames
    for (reader, frames), source in zip(cuts, sources, strict=True):
        fps = reader.manifest.fps
        length = first_sample(done + len(frames), fps) - first_sample(done, fps)
        done += len(frames)
        if source is not None:
            offset_s = -first_sample(frames.start, fps) / SAMPLE_RATE
            for piece in shifted(samples(reader, source), channels, offset_s):
                chosen = piece[:length]
                length -= len(chosen)
                if len(chosen):
                    yield chosen
                if not length:
                    break
        yield np.zeros((length, channels), np.int16)
