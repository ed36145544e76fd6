"""Bytes that no writer of ours makes, and the law of decoders: any give a value or a CodecError."""

from __future__ import annotations

import contextlib
import zlib
from collections.abc import Callable, Iterable

from codec.errors import CodecError
from codec.stream.index import CHECKSUM, HEAD, LAYER, SegmentRecord


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
