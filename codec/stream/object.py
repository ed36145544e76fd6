"""An object: the chunks of one (segment, layer), each in a packet of its own.

Layout: a table of chunks, which is a skippable zstd frame, then one packet for each chunk. The
whole is one valid zstd stream. Nothing is decompressed before the packet has said how much
it holds.
"""

from __future__ import annotations

import struct
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

from codec.coders.coder import EncodedChunk
from codec.coders.effort import Effort
from codec.coders.zstd import CODER, MAGIC, compress, decompress
from codec.errors import CodecError, CorruptError, InvalidError, UnsupportedError

from .manifest import VERSION

SKIPPABLE_MAGIC = 0x184D2A50
TABLE_MAGIC = b"SWGO"

# skippable magic, bytes that follow, table magic, version, coder, zero, number of chunks
HEAD = struct.Struct("<II4sBBHI")
# birth, offset from the start of the object, size
ENTRY = struct.Struct("<iII")
assert HEAD.size == 20
assert ENTRY.size == 12

CODER_OFFSET = 13
"""Where in an object the number of its coder lies."""

NUM_CHUNKS_OFFSET = 16
"""Where in an object the number of its chunks lies."""

MAX_CHUNKS_PER_OBJECT = 1 << 14
"""Chunks in an object; a segment has at most 4096 frames."""

MAX_OBJECT_BYTES = 1 << 30
"""Size of an object as it lies on disk."""


@dataclass(frozen=True, slots=True)
class ChunkEntry:
    """Where the packet of a chunk lies in its object."""

    birth: int
    offset: int  # bytes from the start of the object
    size: int  # bytes


def encode_packet(chunk: EncodedChunk, effort: Effort = Effort.USUAL) -> bytes:
    """`chunk` as one packet with content size and checksum; a chunk of no bytes as no bytes."""
    return compress(chunk.data, chunk.edges, effort) if chunk.data else b""


def packet_content(packet: bytes | memoryview, limit_bytes: int) -> bytes:
    """The bytes of the chunk in `packet`, at most `limit_bytes`: none if the packet has none.
    Raises CorruptError."""
    if not packet:
        return b""
    content = decompress(packet, limit_bytes)
    if not content:
        raise CorruptError("packet: its content is empty; an empty packet must have no bytes")
    return content


def join_packets(packets: Sequence[tuple[int, bytes]]) -> bytes:
    """The object of (birth, packet) pairs in order of birth, without those of no bytes."""
    packets = [(birth, packet) for birth, packet in packets if packet]
    if len(packets) > MAX_CHUNKS_PER_OBJECT:
        raise InvalidError(f"object: {len(packets)} chunks, at most {MAX_CHUNKS_PER_OBJECT}")
    births = [birth for birth, _ in packets]
    if any(b <= a for a, b in pairwise(births)):
        raise InvalidError("object: the births do not rise")
    offset = HEAD.size + ENTRY.size * len(packets)
    if offset + sum(len(packet) for _, packet in packets) > MAX_OBJECT_BYTES:
        raise InvalidError(f"object: over {MAX_OBJECT_BYTES} bytes; use shorter segments")
    head = HEAD.pack(SKIPPABLE_MAGIC, offset - 8, TABLE_MAGIC, VERSION, CODER, 0, len(packets))
    parts = [head]
    for birth, packet in packets:
        parts.append(ENTRY.pack(birth, offset, len(packet)))
        offset += len(packet)
    return b"".join((*parts, *(packet for _, packet in packets)))


def entry_offset(number: int) -> int:
    """Where in an object the entry of its chunk `number` lies."""
    return HEAD.size + ENTRY.size * number


def read_object_table(data: bytes | memoryview) -> list[ChunkEntry]:
    """The entries of an object of which `data` holds at least the table.

    Births rise and the packets lie one after another, from the end of the table on. A CodecError
    says the place of the field that is wrong, or of the first of two that contradict each other.
    """
    if len(data) < HEAD.size:
        raise CorruptError(
            f"object: {len(data)} bytes are too few for a head of {HEAD.size}", len(data)
        )
    skippable, following, magic, found, coder, zero, count = HEAD.unpack_from(data)
    if skippable != SKIPPABLE_MAGIC or magic != TABLE_MAGIC:
        at = 0 if skippable != SKIPPABLE_MAGIC else 8
        raise CorruptError("object: does not start with a table of chunks", at)
    if found != VERSION:
        raise UnsupportedError(f"object: version {found}; this program reads {VERSION}", 12)
    if coder != CODER:
        message = f"object: coder {coder}; this program reads {CODER} (zstd)"
        raise UnsupportedError(message, CODER_OFFSET)
    if zero:
        raise CorruptError(f"object: {zero} where 0 belongs", 14)
    if count > MAX_CHUNKS_PER_OBJECT:
        raise CorruptError(f"object: a table of {count} chunks", NUM_CHUNKS_OFFSET)
    end = HEAD.size + ENTRY.size * count
    if following + 8 != end:
        raise CorruptError(f"object: a table of {count} chunks in {following} bytes", 4)
    if len(data) < end:
        raise CorruptError(f"object: ends inside its table of {count} chunks", len(data))
    entries: list[ChunkEntry] = []
    for birth, offset, size in ENTRY.iter_unpack(data[HEAD.size : end]):
        at = entry_offset(len(entries))
        if entries and birth <= entries[-1].birth:
            message = f"object: birth {birth} after {entries[-1].birth}"
            raise CorruptError(message, at - ENTRY.size)
        if offset != end:
            # Either this offset, or the size in the entry before, which are 8 bytes apart.
            message = f"object: birth {birth} lies at {offset}, not {end}"
            raise CorruptError(message, at - 4 if entries else at + 4)
        end += size
        if end > MAX_OBJECT_BYTES:
            raise CorruptError(f"object: {end} bytes, at most {MAX_OBJECT_BYTES}", at + 8)
        entries.append(ChunkEntry(birth, offset, size))
    return entries


def entry_packet(data: bytes | memoryview, entry: ChunkEntry) -> memoryview:
    """The packet of `entry` in the object `data`. A CodecError says where it begins, or ends."""
    packet = memoryview(data)[entry.offset : entry.offset + entry.size]
    if len(packet) < entry.size:
        raise CorruptError(f"object: ends inside the chunk of birth {entry.birth}", len(data))
    if packet[: len(MAGIC)] != MAGIC:
        raise error_in_object(CorruptError("packet: is not a zstd frame"), entry)
    return packet


def object_end(entries: Sequence[ChunkEntry]) -> int:
    """Where an object with these entries ends."""
    if not entries:
        return HEAD.size
    return entries[-1].offset + entries[-1].size


def error_in_object(error: CodecError, entry: ChunkEntry) -> CodecError:
    """`error`, whose place is one in the decompressed chunk of `entry`, as one of the object."""
    place = "" if error.at is None else f", byte {error.at} in it"
    message = f"{error} (chunk of birth {entry.birth}, {entry.size} bytes{place})"
    return error.reworded(message, entry.offset)
