"""A stream as one file, and back: what is in it stays as it is, byte for byte."""

from __future__ import annotations

import zlib
from dataclasses import dataclass
from pathlib import Path

from codec.errors import CorruptError, InvalidError
from codec.files import making_folder, replacing, write_atomic
from codec.outputlock import writing_alone
from codec.storage.openstorage import Place
from codec.storage.storage import Storage
from codec.stream.index import INDEX_NAME
from codec.stream.integrity import MAX_INDEX_BYTES
from codec.stream.object import MAX_OBJECT_BYTES
from codec.stream.packedlayout import PACKED_SUFFIX
from codec.stream.packedstorage import PackedStorage
from codec.stream.packedtracks import TRACKS_NAME
from codec.stream.reader import StreamReader, read_stream_file
from codec.stream.streampacker import StreamPacker


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
