"""Bytes that no writer of ours makes, and the law of decoders: any give a value or a CodecError."""

from __future__ import annotations

import contextlib
import hashlib
import math
import zlib
from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from pathlib import Path

from codec.errors import CodecError
from codec.stream.index import CHECKSUM, HEAD, LAYER, SegmentRecord, pack_record
from codec.stream.reader import StreamReader


def survives(decode: Callable[[bytes], object], data: bytes) -> bool:
    """Whether `decode` gave a value; anything but a value or a CodecError rises."""
    with contextlib.suppress(CodecError):
        decode(data)
        return True
    return False


def truncations(data: bytes) -> Iterable[bytes]:
    """Every proper prefix of `data`."""
    return (data[:length] for length in range(len(data)))


def flips(data: bytes, every: int = 1) -> Iterable[bytes]:
    """`data` with one byte altered in each of three ways, at every `every`-th place."""
    for place in range(0, len(data), every):
        for value in (data[place] ^ 1, data[place] ^ 0x80, 255 - data[place]):
            yield data[:place] + bytes([value]) + data[place + 1 :]


def forged_record(record: SegmentRecord) -> bytes:
    """A record of the index with a right checksum, whatever rule it breaks."""
    body = HEAD.pack(record.segment, record.first_frame, record.num_frames, 0) + b"".join(
        LAYER.pack(*layer)
        for layer in zip(record.object_bytes, record.object_sha256, record.psnr_db, strict=True)
    )
    return body + CHECKSUM.pack(zlib.crc32(body))


def record_of(segment: int, num_frames: int, objects: Sequence[bytes]) -> SegmentRecord:
    """The record of a segment, of segments of 4 frames, with `objects` as its layers."""
    return SegmentRecord(
        segment,
        4 * segment,
        num_frames,
        tuple(map(len, objects)),
        tuple(hashlib.sha256(data).digest() for data in objects),
        (math.nan,) * len(objects),
    )


def put_object(stream: Path, segment: int, layer: int, data: bytes) -> None:
    """Replaces an object and says so in the index, as a faulty writer would."""
    (stream / "segments" / str(segment) / str(layer)).write_bytes(data)
    records = list(StreamReader(stream).records)
    sizes, hashes = list(records[segment].object_bytes), list(records[segment].object_sha256)
    sizes[layer], hashes[layer] = len(data), hashlib.sha256(data).digest()
    records[segment] = replace(
        records[segment], object_bytes=tuple(sizes), object_sha256=tuple(hashes)
    )
    (stream / "index.bin").write_bytes(b"".join(map(pack_record, records)))
