"""index.bin: one fixed-size record for each finished segment, only ever appended to.

Rule: record n describes segment n, so any reader can fetch it by byte range.
"""

from __future__ import annotations

import hashlib
import math
import struct
import zlib
from collections.abc import Sequence
from dataclasses import dataclass

from codec.errors import CorruptError, InvalidError
from codec.slots.slotlayout import MAX_LAYERS

INDEX_NAME = "index.bin"

# segment, first frame, frames, zero
HEAD = struct.Struct("<IIII")
# object bytes, object sha256, PSNR in dB of layers 0..this (NaN: unknown)
LAYER = struct.Struct("<Q32sf")
# object bytes, object sha256: of the masks, then of each snapshot
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
    side_bytes: tuple[int, ...]  # of the masks, then of each snapshot
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
        layers = len(objects) // 2  # as many snapshots, and the masks
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
        """Bytes that a player of all layers from frame 0 on fetches: no snapshot but the first."""
        masks_end = len(self.object_bytes) + 1
        return sum(self.part_bytes if self.segment == 0 else self.part_bytes[:masks_end])

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
    """Where in a record the size of the masks (0) or of a snapshot (1 + layer) lies."""
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
            raise ValueError(f"{len(sides)} objects of masks and snapshots")
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
