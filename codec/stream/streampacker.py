"""A stream as one file, and back; packed piece by piece, for a disk or for a client that downloads
it.

Rule: what is in it stays as it is, byte for byte. Little is held at a time, and no byte is given
that was not checked: what has changed since the beginning ends the packing with an error.
"""

from __future__ import annotations

import zlib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from codec.errors import CodecError, CorruptError, InvalidError
from codec.files import making_folder, replacing, write_atomic
from codec.outputlock import writing_alone
from codec.storage.openstorage import Place
from codec.storage.storage import Storage

from .captions import MAX_CAPTIONS_BYTES
from .integrity import MAX_INDEX_BYTES, check_index_end, check_object_bytes
from .manifest import MANIFEST_NAME, SEGMENTS_NAME, Manifest, Part, object_name
from .packedlayout import (
    PACKED_SUFFIX,
    TRACKS_NAME,
    PackedHead,
    PackedLayout,
    TrackSizes,
    picture_paths,
)
from .packedstorage import PackedStorage
from .pictures import read_picture
from .reader import StreamReader, read_stream_file
from .segment import INDEX_NAME, MAX_OBJECT_BYTES, SegmentRecord
from .sound import MAX_SOUND_BYTES, checked_object, first_sample


class StreamPacker:
    """A stream that becomes one file. Its methods block."""

    def __init__(
        self,
        storage: Storage,
        manifest: Manifest,
        manifest_json: bytes,
        records: Sequence[SegmentRecord],
        index: bytes,
    ) -> None:
        """Raises InvalidError for a stream that is live or has no frames, a CodecError for one that
        is damaged."""
        if manifest.live:
            raise InvalidError(f"{storage.name} is live; pack it when it is finished")
        if not records:
            raise InvalidError(f"{storage.name} has no frames; there is nothing to pack")
        self._storage = storage
        self._manifest = manifest
        self._records = records
        try:
            check_index_end(len(index), manifest, len(records))
        except CodecError as error:
            raise error.within(storage.place(INDEX_NAME)) from error
        paths = picture_paths(manifest)
        found = {path: read_picture(storage, path) for path in paths if path}
        pictures = {path: data for path, data in found.items() if data}
        captions = {
            each.file_name: read_stream_file(storage, each.file_name, MAX_CAPTIONS_BYTES)
            for each in manifest.captions
        }
        tracks = self._tracks([*map(len, captions.values())])
        self._files = {MANIFEST_NAME: manifest_json, INDEX_NAME: index, TRACKS_NAME: tracks}
        """The small files, by path."""
        self._files |= {**pictures, **captions}
        poster_bytes, storyboard_bytes = (len(pictures.get(path or "", b"")) for path in paths)
        head = PackedHead(
            len(manifest_json), len(index), poster_bytes, storyboard_bytes, len(tracks)
        )
        self.layout = PackedLayout(head, manifest, records, tracks)

    def _tracks(self, captions: list[int]) -> bytes:
        """The table of sizes."""
        sources = [source.part for source in self._manifest.sound]
        sizes = dict(self._storage.sizes(SEGMENTS_NAME)) if sources else {}
        sound = np.zeros((len(self._records), len(sources)), np.int64)
        for segment, column in np.ndindex(*sound.shape):
            path = object_name(segment, sources[column])
            # Where there is none, reading it says so.
            sound[segment, column] = sizes.get(path) or len(self._sound(segment, sources[column]))
        return TrackSizes(tuple(captions), sound).to_bytes()

    def pieces(self) -> Iterator[bytes]:
        """All bytes of the file, in order. Raises a CodecError where the stream is damaged, or is
        not what it was at the beginning any more."""
        content, sizes = b"", (size_bytes for _, _, size_bytes in self.layout.files())

        def checksum(path: str) -> int:
            nonlocal content
            content = self.read(path)
            if len(content) != next(sizes):
                raise CorruptError(f"{self._storage.place(path)} has changed meanwhile")
            return zlib.crc32(content)

        for _, piece in self.layout.structure(checksum):
            yield piece
            yield content
            content = b""

    def read(self, path: str) -> bytes:
        """The file at `path`, which the stream has. Raises a CodecError."""
        if path in self._files:
            return self._files[path]
        segment, part = self.layout.address(path) or (0, 0)
        if part not in self._manifest.parts:
            return self._sound(segment, part)
        # The hash is enough: what is in it stays as it is.
        data = read_stream_file(self._storage, path, MAX_OBJECT_BYTES)
        record, number = self._records[segment], self._manifest.part_number(part)
        try:
            check_object_bytes(data, record, number)
        except CodecError as error:
            raise error.within(self._storage.place(path)) from error
        return data

    def _sound(self, segment: int, part: Part) -> bytes:
        """An object of sound, if it is one of its source and segment."""
        path, record = object_name(segment, part), self._records[segment]
        source = next(each for each in self._manifest.sound if each.part == part)
        data = read_stream_file(self._storage, path, MAX_SOUND_BYTES)
        frames = record.first_frame, record.first_frame + record.num_frames
        begin, stop = (first_sample(frame, self._manifest.fps) for frame in frames)
        try:
            checked_object(data, source, begin, stop)
        except CodecError as error:
            raise error.within(self._storage.place(path)) from error
        return data


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
    packer = _packer(reader)
    with writing_alone(out), replacing(out) as temporary, open(temporary, "wb") as file:
        for piece in packer.pieces():
            file.write(piece)
    num_files = sum(path != TRACKS_NAME for path, _, _ in packer.layout.files())
    return Packed(reader.num_frames, num_files, packer.layout.size_bytes)


def _packer(reader: StreamReader) -> StreamPacker:
    index = read_stream_file(reader.storage, INDEX_NAME, MAX_INDEX_BYTES)
    return StreamPacker(
        reader.storage, reader.manifest, reader.manifest_json, reader.records, index
    )


def unpack_stream(packed: Place, out: Path) -> Packed:
    """Writes the files of the packed stream at `packed` to the folder `out`, absent or empty.

    Objects are checked against the index. `out` appears whole or not at all. Raises InvalidError if
    `packed` is not a packed stream, a CodecError if it is damaged.
    """
    reader = StreamReader(packed, max_gaussians=None)
    storage = reader.storage
    if not isinstance(storage, PackedStorage):
        raise InvalidError(f"{reader.name} is not a packed stream; its files are there already")
    packer, size_bytes, num_files = _packer(reader), 0, 0
    with making_folder(out) as folder:
        for path, _, _ in storage.layout.files():
            if path == TRACKS_NAME:
                continue
            data = packer.read(path)
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
