"""The bytes of a segment: its objects, each a table and the packets of one layer's chunks, and its
record in index.bin, which holds their sizes, hashes and PSNR.

Rule: record n has a fixed size and describes segment n, so any reader can fetch it by byte range.
The table of an object is a skippable zstd frame.
Nothing is decompressed before the packet has said how much it holds.
"""

from __future__ import annotations

import hashlib
import math
import struct
import zlib
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

from codec.coders.blocks import Effort
from codec.coders.coder import EncodedChunk
from codec.coders.zstd import MAGIC, compress, decompress, with_start
from codec.errors import CodecError, CorruptError, InvalidError, UnsupportedError
from codec.slots.changepacket import (
    FORM,
    change_content,
    encode_change_packet,
    renumbered_change,
)
from codec.slots.slotlayout import MAX_LAYERS

from .manifest import VERSION

INDEX_NAME = "index.bin"

# segment, first frame, frames, zero
HEAD = struct.Struct("<IIII")
# object bytes, object sha256, PSNR in dB of layers 0..this (NaN: unknown)
LAYER = struct.Struct("<Q32sf")
# object bytes, object sha256: of the skip maps, then of each keyframe
SIDE = struct.Struct("<Q32s")
CHECKSUM = struct.Struct("<I")
assert HEAD.size == 16
assert LAYER.size == 44
assert SIDE.size == 40
assert CHECKSUM.size == 4


@dataclass(frozen=True, slots=True)
class SegmentRecord:
    """The record of one segment in the index; the tuples have one entry for each layer."""

    segment: int
    first_frame: int
    num_frames: int  # at least 1
    object_bytes: tuple[int, ...]
    object_sha256: tuple[bytes, ...]
    psnr_db: tuple[float, ...]  # of layers 0..n together, float32; NaN where unknown
    side_bytes: tuple[int, ...]  # of the skip maps, then of each keyframe
    side_sha256: tuple[bytes, ...]

    @staticmethod
    def of(
        objects: Sequence[bytes],
        segment: int,
        first_frame: int,
        num_frames: int,
        psnr_db: tuple[float, ...] | None,
    ) -> SegmentRecord:
        """The record of a segment of these objects, in the order of `Manifest.parts`. psnr_db: None
        if unknown."""
        layers = len(objects) // 2  # as many keyframes, and the skip maps
        sizes = tuple(map(len, objects))
        hashes = tuple(hashlib.sha256(data).digest() for data in objects)
        return SegmentRecord(
            segment,
            first_frame,
            num_frames,
            sizes[:layers],
            hashes[:layers],
            (math.nan,) * layers if psnr_db is None else psnr_db,
            sizes[layers:],
            hashes[layers:],
        )

    @property
    def part_bytes(self) -> tuple[int, ...]:
        """The size of each object, in the order of `Manifest.parts`."""
        return self.object_bytes + self.side_bytes

    @property
    def played_bytes(self) -> int:
        """Bytes that a player of all layers from frame 0 on fetches: no keyframe but the first."""
        skip_maps_end = len(self.object_bytes) + 1
        return sum(self.part_bytes if self.segment == 0 else self.part_bytes[:skip_maps_end])

    @property
    def part_sha256(self) -> tuple[bytes, ...]:
        """The hash of each object, in the order of `Manifest.parts`."""
        return self.object_sha256 + self.side_sha256


def record_bytes(num_layers: int) -> int:
    """The size of a record in a stream of `num_layers` layers."""
    if not 1 <= num_layers <= MAX_LAYERS:
        raise InvalidError(f"index: {num_layers} layers, expected 1 to {MAX_LAYERS}")
    return size_offset(num_layers) + SIDE.size * (num_layers + 1) + CHECKSUM.size


def size_offset(layer: int) -> int:
    """Where in a record the object size of `layer` lies."""
    return HEAD.size + LAYER.size * layer


def side_offset(number: int, num_layers: int) -> int:
    """Where in a record the size of the skip maps (0) or of a keyframe (1 + layer) lies."""
    return size_offset(num_layers) + SIDE.size * number


def psnr_offset(layer: int) -> int:
    """Where in a record the PSNR of `layer` lies."""
    return size_offset(layer) + LAYER.size - 4


def pack_record(record: SegmentRecord) -> bytes:
    """The record's bytes, its CRC32 last."""
    try:
        layers = list(zip(record.object_bytes, record.object_sha256, record.psnr_db, strict=True))
        sides = list(zip(record.side_bytes, record.side_sha256, strict=True))
        if len(sides) != len(layers) + 1:
            raise ValueError(f"{len(sides)} objects of skip maps and keyframes")
        if any(len(sha256) != 32 for sha256 in record.part_sha256):
            raise ValueError("a sha256 has 32 bytes")
        if any(map(math.isinf, record.psnr_db)):
            raise ValueError("a PSNR is infinite; cap it, or use NaN if it is unknown")
        head = HEAD.pack(record.segment, record.first_frame, record.num_frames, 0)
        rows = [LAYER.pack(*layer) for layer in layers] + [SIDE.pack(*side) for side in sides]
        body = head + b"".join(rows)
    except (struct.error, ValueError, OverflowError) as error:
        raise InvalidError(f"index: segment {record.segment}: {error}") from error
    return body + CHECKSUM.pack(zlib.crc32(body))


def _unpack(data: memoryview, segment: int, num_layers: int) -> SegmentRecord:
    body = data[: -CHECKSUM.size]
    what = f"index: the record of segment {segment}"
    if CHECKSUM.unpack_from(data, len(body))[0] != zlib.crc32(body):
        raise CorruptError(f"{what}, {len(data)} bytes, has a wrong checksum", at=0)
    number, first_frame, num_frames, zero = HEAD.unpack_from(body)
    layers_end = size_offset(num_layers)
    sizes, hashes, psnrs = zip(*LAYER.iter_unpack(body[HEAD.size : layers_end]), strict=True)
    sides = tuple(zip(*SIDE.iter_unpack(body[layers_end:]), strict=True))
    if number != segment:
        raise CorruptError(f"{what} describes {number}", at=0)
    if num_frames < 1:
        raise CorruptError(f"{what} has no frames", at=8)
    if zero:
        raise CorruptError(f"{what} has {zero} where 0 belongs", at=12)
    for layer, psnr in enumerate(psnrs):
        if math.isinf(psnr):
            raise CorruptError(f"{what} has an infinite PSNR", at=psnr_offset(layer))
    return SegmentRecord(segment, first_frame, num_frames, sizes, hashes, psnrs, *sides)


def parse_index(data: bytes, num_layers: int, first_segment: int = 0) -> list[SegmentRecord]:
    """The records in `data`, of which the first is that of `first_segment`.

    A torn last record (cut short, or all zeros as a file system may leave it after a power cut) is
    left out; a record that is wrong by itself raises CorruptError with its place in `data`. Whether
    records follow each other and fit the manifest, `integrity.read_index` checks.
    """
    size = record_bytes(num_layers)
    view = memoryview(data)
    count = len(data) // size
    if count and not any(view[(count - 1) * size : count * size]):
        count -= 1
    records: list[SegmentRecord] = []
    for n in range(count):
        try:
            records.append(_unpack(view[n * size : (n + 1) * size], first_segment + n, num_layers))
        except CorruptError as error:
            raise error.moved(n * size) from error
    return records


CODER = 2
"""The number of the coder in the head of an object: packets are zstd frames, and those of changes
perhaps coded planes. The coder of older development versions was 1, zstd alone."""

SKIPPABLE_MAGIC = 0x184D2A50
TABLE_MAGIC = b"SWGO"

# skippable magic, bytes that follow, table magic, version, coder, zero, number of chunks
OBJECT_HEAD = struct.Struct("<II4sBBHI")
# birth, offset from the start of the object, size
ENTRY = struct.Struct("<iII")
assert OBJECT_HEAD.size == 20
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
    if not chunk.data:
        return b""
    packet = compress(chunk.data, chunk.edges, effort)
    if chunk.sh_degree is None:
        return packet
    return min(encode_change_packet(chunk.data, chunk.sh_degree), packet, key=len)


def renumbered_packet(packet: bytes, chunk: EncodedChunk) -> bytes:
    """The packet of `chunk`, which differs from that of `packet` in its birth alone."""
    if packet[0] == FORM:
        return renumbered_change(packet, chunk.birth)
    copied = with_start(packet, chunk.data)
    return encode_packet(chunk) if copied is None else copied


def packet_content(packet: bytes | memoryview, limit_bytes: int) -> bytes:
    """The bytes of the chunk in `packet`, at most `limit_bytes`: none if the packet has none.
    Raises CorruptError."""
    if not packet:
        return b""
    decode = change_content if packet[0] == FORM else decompress
    content = decode(packet, limit_bytes)
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
    offset = OBJECT_HEAD.size + ENTRY.size * len(packets)
    if offset + sum(len(packet) for _, packet in packets) > MAX_OBJECT_BYTES:
        raise InvalidError(f"object: over {MAX_OBJECT_BYTES} bytes; use shorter segments")
    head = OBJECT_HEAD.pack(
        SKIPPABLE_MAGIC, offset - 8, TABLE_MAGIC, VERSION, CODER, 0, len(packets)
    )
    parts = [head]
    for birth, packet in packets:
        parts.append(ENTRY.pack(birth, offset, len(packet)))
        offset += len(packet)
    return b"".join((*parts, *(packet for _, packet in packets)))


def entry_offset(number: int) -> int:
    """Where in an object the entry of its chunk `number` lies."""
    return OBJECT_HEAD.size + ENTRY.size * number


def read_object_table(data: bytes | memoryview) -> list[ChunkEntry]:
    """The entries of an object of which `data` holds at least the table.

    Births rise and the packets lie one after another, from the end of the table on. A CodecError
    says the place of the field that is wrong, or of the first of two that contradict each other.
    """
    if len(data) < OBJECT_HEAD.size:
        raise CorruptError(
            f"object: {len(data)} bytes are too few for a head of {HEAD.size}", len(data)
        )
    skippable, following, magic, found, coder, zero, count = OBJECT_HEAD.unpack_from(data)
    if skippable != SKIPPABLE_MAGIC or magic != TABLE_MAGIC:
        at = 0 if skippable != SKIPPABLE_MAGIC else 8
        raise CorruptError("object: does not start with a table of chunks", at)
    if found != VERSION:
        raise UnsupportedError(f"object: version {found}; this program reads {VERSION}", 12)
    if coder != CODER:
        message = f"object: coder {coder}; this program reads {CODER}, so make the stream anew"
        raise UnsupportedError(message, CODER_OFFSET)
    if zero:
        raise CorruptError(f"object: {zero} where 0 belongs", 14)
    if count > MAX_CHUNKS_PER_OBJECT:
        raise CorruptError(f"object: a table of {count} chunks", NUM_CHUNKS_OFFSET)
    end = OBJECT_HEAD.size + ENTRY.size * count
    if following + 8 != end:
        raise CorruptError(f"object: a table of {count} chunks in {following} bytes", 4)
    if len(data) < end:
        raise CorruptError(f"object: ends inside its table of {count} chunks", len(data))
    entries: list[ChunkEntry] = []
    for birth, offset, size in ENTRY.iter_unpack(data[OBJECT_HEAD.size : end]):
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
    if packet[0] != FORM and packet[: len(MAGIC)] != MAGIC:
        raise error_in_object(CorruptError("packet: is neither coded nor a zstd frame"), entry)
    return packet


def object_end(entries: Sequence[ChunkEntry]) -> int:
    """Where an object with these entries ends."""
    if not entries:
        return OBJECT_HEAD.size
    return entries[-1].offset + entries[-1].size


def error_in_object(error: CodecError, entry: ChunkEntry) -> CodecError:
    """`error`, whose place is one in the decompressed chunk of `entry`, as one of the object."""
    place = "" if error.at is None else f", byte {error.at} in it"
    message = f"{error} (chunk of birth {entry.birth}, {entry.size} bytes{place})"
    return error.reworded(message, entry.offset)
