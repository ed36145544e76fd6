"""A stream as one file, and back: what is in it stays as it is, byte for byte."""

from __future__ import annotations

import zlib
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from codec.errors import CodecError, CorruptError, InvalidError
from codec.files import making_folder, replacing, write_atomic
from codec.storage.openstorage import Place
from codec.storage.storage import Storage
from codec.stream.captions import MAX_CAPTIONS_BYTES
from codec.stream.index import INDEX_NAME
from codec.stream.integrity import MAX_INDEX_BYTES, check_index_end, check_object_bytes
from codec.stream.manifest import MANIFEST_NAME, Part, object_name
from codec.stream.object import MAX_OBJECT_BYTES
from codec.stream.packedlayout import (
    PACKED_SUFFIX,
    PackedHead,
    PackedLayout,
    picture_paths,
)
from codec.stream.packedstorage import PackedStorage
from codec.stream.packedtracks import TRACKS_NAME, TrackSizes
from codec.stream.pictures import read_picture
from codec.stream.reader import StreamReader, read_stream_file
from codec.stream.sound import MAX_SOUND_BYTES, checked_object, first_sample


@dataclass(frozen=True, slots=True)
class Packed:
    """The result of `pack_stream` or `unpack_stream`."""

    num_frames: int
    num_files: int
    size_bytes: int
    """Size of all written files."""


def pack_stream(stream: Place, out: Path) -> Packed:
    """Writes the stream at `stream` to the file `out`, which must end with `.swings`; one that is
    there is replaced once the new one is whole.

    Objects are checked against the index, but not decoded. Equal streams give equal files. Raises
    InvalidError for a stream that is live or has no frames, a CodecError for one that is damaged.
    """
    if not out.name.endswith(PACKED_SUFFIX) or out.is_dir():
        raise InvalidError(f"{out} cannot be written; name a file that ends with {PACKED_SUFFIX}")
    reader = StreamReader(stream, max_gaussians=None)
    if reader.manifest.live:
        raise InvalidError(f"{reader.name} is live; pack it when it is finished")
    if not reader.records:
        raise InvalidError(f"{reader.name} has no frames; there is nothing to pack")
    files = _Files(reader)
    poster, storyboard = (
        len(files.pictures.get(path or "", b"")) for path in picture_paths(reader.manifest)
    )
    manifest_bytes, index_bytes = len(reader.manifest_json), len(files.index)
    head = PackedHead(manifest_bytes, index_bytes, poster, storyboard, len(files.tracks))
    layout = PackedLayout(head, reader.manifest, reader.records, files.tracks)
    with replacing(out) as temporary, open(temporary, "wb") as file:
        content = b""

        def checksum(path: str) -> int:
            nonlocal content
            content = files.read(path)
            return zlib.crc32(content)

        for at, piece in layout.structure(checksum):
            assert file.tell() == at, (file.tell(), at)
            file.write(piece)
            file.write(content)
            content = b""
    num_files = sum(path != TRACKS_NAME for path, _, _ in layout.files())
    return Packed(reader.num_frames, num_files, layout.size_bytes)


class _Files:
    """The files of a stream that is packed."""

    def __init__(self, reader: StreamReader) -> None:
        self._reader = reader
        storage = reader.storage
        self.index = read_stream_file(storage, INDEX_NAME, MAX_INDEX_BYTES)
        try:
            check_index_end(len(self.index), reader.manifest, len(reader.records))
        except CodecError as error:
            raise error.within(storage.place(INDEX_NAME)) from error
        found = {path: read_picture(storage, path) for path in picture_paths(reader.manifest)}
        self.pictures = {path: data for path, data in found.items() if path and data}
        self.captions = {
            each.file_name: read_stream_file(storage, each.file_name, MAX_CAPTIONS_BYTES)
            for each in reader.manifest.captions
        }
        self._sound = {
            object_name(record.segment, source.part): (record, source)
            for record in reader.records
            for source in reader.manifest.sound
        }
        self.tracks = self._tracks()
        self._objects: dict[str, tuple[int, Part]] = {
            object_name(record.segment, part): (record.segment, part)
            for record in reader.records
            for part in reader.manifest.parts
        }

    def _tracks(self) -> bytes:
        """The table of sizes. Reads all objects of sound, one after another: they are small."""
        sound = [len(self._sound_object(path)) for path in self._sound]
        shape = len(self._reader.records), len(self._reader.manifest.sound)
        captions = tuple(map(len, self.captions.values()))
        return TrackSizes(captions, np.array(sound, np.int64).reshape(shape)).to_bytes()

    def _sound_object(self, path: str) -> bytes:
        """An object of sound, if it is one of its source and segment."""
        record, source = self._sound[path]
        data = read_stream_file(self._reader.storage, path, MAX_SOUND_BYTES)
        frames = record.first_frame, record.first_frame + record.num_frames
        begin, stop = (first_sample(frame, self._reader.manifest.fps) for frame in frames)
        try:
            checked_object(data, source, begin, stop)
        except CodecError as error:
            raise error.within(self._reader.storage.place(path)) from error
        return data

    def read(self, path: str) -> bytes:
        if path == MANIFEST_NAME:
            return self._reader.manifest_json
        if path == INDEX_NAME:
            return self.index
        if path == TRACKS_NAME:
            return self.tracks
        if path in self.pictures:
            return self.pictures[path]
        if path in self.captions:
            return self.captions[path]
        if path in self._sound:
            return self._sound_object(path)
        segment, part = self._objects[path]
        # The hash is enough: what is in it stays as it is.
        data = read_stream_file(self._reader.storage, path, MAX_OBJECT_BYTES)
        record, number = self._reader.records[segment], self._reader.manifest.part_number(part)
        try:
            check_object_bytes(data, record, number)
        except CodecError as error:
            raise error.within(self._reader.storage.place(path)) from error
        return data


def unpack_stream(packed: Place, out: Path) -> Packed:
    """Writes the files of the packed stream at `packed` to the folder `out`, absent or empty.

    Objects are checked against the index. `out` appears whole or not at all. Raises InvalidError if
    `packed` is not a packed stream, a CodecError if it is damaged.
    """
    reader = StreamReader(packed, max_gaussians=None)
    storage = reader.storage
    if not isinstance(storage, PackedStorage):
        raise InvalidError(f"{reader.name} is not a packed stream; its files are there already")
    files, size_bytes, num_files = _Files(reader), 0, 0
    with making_folder(out) as folder:
        for path, _, _ in storage.layout.files():
            if path == TRACKS_NAME:
                continue
            data = files.read(path)
            target = folder / path
            target.parent.mkdir(parents=True, exist_ok=True)
            write_atomic(target, data)
            size_bytes, num_files = size_bytes + len(data), num_files + 1
    return Packed(reader.num_frames, num_files, size_bytes)


def verify_packed(storage: Storage) -> None:
    """Raises CorruptError, with the byte, unless all that lies between the files of a packed stream
    is what `pack_stream` writes. Any other storage is passed over."""
    if not isinstance(storage, PackedStorage):
        return
    layout = storage.layout

    def checksum(path: str) -> int:
        return zlib.crc32(read_stream_file(storage, path, MAX_OBJECT_BYTES))

    for at, expected in layout.structure(checksum):
        found = storage.read_raw(at, len(expected))
        if found != expected:
            at += next(
                n for n, pair in enumerate(zip(found, expected, strict=True)) if len({*pair}) > 1
            )
            raise CorruptError(
                f"{storage.name}: byte {at}: a record of the ZIP file is not what it must be", at
            )
