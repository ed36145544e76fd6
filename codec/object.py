"""An object: the chunks of one (segment, layer) as one valid zstd stream.

Layout: a skippable frame with the table of chunks, then one zstd frame for each chunk. Nothing is
decompressed before the frame's own header has said how much it holds.
"""

from __future__ import annotations

import struct
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

from .chunk import MAX_CHUNK_BYTES, Chunk, decode_chunk, plane_edges, read_header
from .coder import compress, decompress
from .errors import CorruptError, InvalidError, UnsupportedError

SKIPPABLE_MAGIC = 0x184D2A50
TABLE_MAGIC = b"SWGO"
VERSION = 1
CODER_ZSTD = 1
"""The entropy coder of the frames; others are free for exports to static hosts."""

# skippable magic, bytes that follow, table magic, version, coder, zero, number of chunks
HEAD = struct.Struct("<II4sBBHI")
# birth, offset from the start of the object, size
ENTRY = struct.Struct("<iII")
assert HEAD.size == 20
assert ENTRY.size == 12

MAX_CHUNKS_PER_OBJECT = 1 << 14
"""Chunks in an object; a segment has at most 4096 frames and the genesis window in front."""

MAX_OBJECT_BYTES = 1 << 30
"""Size of an object as it lies on disk."""

MAX_SPLATS_PER_OBJECT = 1 << 24
"""Gaussians that `decode_object` gives at most: about 1 GB."""


@dataclass(frozen=True, slots=True)
class ChunkEntry:
    """Where the frame of a chunk lies in its object."""

    birth: int
    offset: int  # bytes from the start of the object
    size: int  # bytes


def encode_frame(chunk: bytes) -> bytes:
    """`chunk` as one zstd frame with content size and checksum."""
    return compress(chunk, plane_edges(chunk))


def decode_frame(data: bytes | memoryview) -> Chunk:
    """The chunk in one zstd frame, which `data` holds exactly. Memory is bounded."""
    return decode_chunk(decompress(data, MAX_CHUNK_BYTES))


def join_frames(frames: Sequence[tuple[int, bytes]]) -> bytes:
    """The object of (birth, zstd frame) pairs in order of birth."""
    if not 1 <= len(frames) <= MAX_CHUNKS_PER_OBJECT:
        raise InvalidError(f"object: {len(frames)} chunks, expected 1 to {MAX_CHUNKS_PER_OBJECT}")
    births = [birth for birth, _ in frames]
    if any(b <= a for a, b in pairwise(births)):
        raise InvalidError("object: the births do not rise")
    offset = HEAD.size + ENTRY.size * len(frames)
    if offset + sum(len(frame) for _, frame in frames) > MAX_OBJECT_BYTES:
        raise InvalidError(f"object: over {MAX_OBJECT_BYTES} bytes; use shorter segments")
    head = HEAD.pack(SKIPPABLE_MAGIC, offset - 8, TABLE_MAGIC, VERSION, CODER_ZSTD, 0, len(frames))
    parts = [head]
    for birth, frame in frames:
        parts.append(ENTRY.pack(birth, offset, len(frame)))
        offset += len(frame)
    return b"".join((*parts, *(frame for _, frame in frames)))


def encode_object(chunks: Sequence[bytes]) -> bytes:
    """The object of `chunks`, which come in order of birth."""
    return join_frames([(read_header(chunk).birth, encode_frame(chunk)) for chunk in chunks])


def read_object_table(data: bytes | memoryview) -> list[ChunkEntry]:
    """The entries of an object of which `data` holds at least the table.

    Births rise and the frames lie one after another, from the end of the table on.
    """
    if len(data) < HEAD.size:
        raise CorruptError(f"object: {len(data)} bytes are no head of {HEAD.size}")
    skippable, following, magic, version, coder, zero, count = HEAD.unpack_from(data)
    if skippable != SKIPPABLE_MAGIC or magic != TABLE_MAGIC:
        raise CorruptError("object: does not start with a table of chunks")
    if version != VERSION:
        raise UnsupportedError(f"object: version {version}; this program reads {VERSION}")
    if coder != CODER_ZSTD:
        raise UnsupportedError(f"object: coder {coder}; this program reads {CODER_ZSTD} (zstd)")
    end = HEAD.size + ENTRY.size * count
    if not 1 <= count <= MAX_CHUNKS_PER_OBJECT or following + 8 != end or zero:
        raise CorruptError(f"object: a table of {count} chunks in {following} bytes")
    if len(data) < end:
        raise CorruptError(f"object: ends inside its table of {count} chunks")
    entries: list[ChunkEntry] = []
    for birth, offset, size in ENTRY.iter_unpack(data[HEAD.size : end]):
        if entries and birth <= entries[-1].birth:
            raise CorruptError(f"object: birth {birth} after {entries[-1].birth}")
        if offset != end:
            raise CorruptError(f"object: birth {birth} lies at {offset}, not {end}")
        end += size
        entries.append(ChunkEntry(birth, offset, size))
    if end > MAX_OBJECT_BYTES:
        raise CorruptError(f"object: {end} bytes, at most {MAX_OBJECT_BYTES}")
    return entries


def _whole_table(data: bytes | memoryview) -> list[ChunkEntry]:
    entries = read_object_table(data)
    end = entries[-1].offset + entries[-1].size
    if len(data) != end:
        raise CorruptError(f"object: {len(data)} bytes, its table says {end}")
    return entries


def decode_object_chunk(data: bytes | memoryview, entry: ChunkEntry) -> Chunk:
    """The chunk of one entry of the object `data`."""
    frame = memoryview(data)[entry.offset : entry.offset + entry.size]
    chunk = decode_frame(frame)
    if chunk.birth != entry.birth:
        raise CorruptError(f"object: birth {chunk.birth} where the table says {entry.birth}")
    return chunk


def decode_object(data: bytes | memoryview) -> list[Chunk]:
    """All chunks of the object `data`, in order of birth."""
    chunks: list[Chunk] = []
    total = 0
    for entry in _whole_table(data):
        chunks.append(decode_object_chunk(data, entry))
        total += len(chunks[-1].slice.splats)
        if total > MAX_SPLATS_PER_OBJECT:
            raise CorruptError(f"object: over {MAX_SPLATS_PER_OBJECT} Gaussians")
    return chunks


def object_frames(data: bytes | memoryview) -> list[tuple[int, bytes]]:
    """(birth, the still compressed zstd frame) of every chunk of the object `data`, in order."""
    view = memoryview(data)
    return [(e.birth, bytes(view[e.offset : e.offset + e.size])) for e in _whole_table(data)]
