"""Integers as other programs pack them: zigzag, byte planes, deflate or zstd. What they claim to
unpack to is checked before anything is allocated."""

from __future__ import annotations

import zlib

import numpy as np
import numpy.typing as npt
import zstandard

from codec.errors import CorruptError

Ints = npt.NDArray[np.int64]
WIDTHS = (1, 2, 4)
"""Bytes that a symbol may have."""


def inflated(data: bytes | memoryview, raw_bytes: int, what: str) -> bytes:
    """The `raw_bytes` that the zlib stream `data` holds. Raises CorruptError."""
    stream = zlib.decompressobj()
    try:
        content = stream.decompress(data, raw_bytes + 1)
    except zlib.error as error:
        raise CorruptError(f"{what}: {error}") from error
    if len(content) != raw_bytes or not stream.eof:
        raise CorruptError(f"{what}: does not inflate to {raw_bytes} bytes")
    return content


def unzstd(frame: bytes | memoryview, raw_bytes: int, what: str) -> bytes:
    """The `raw_bytes` that the zstd frame holds. Raises CorruptError."""
    try:
        # One that says its size is given that much memory, whatever the limit.
        said = zstandard.get_frame_parameters(frame).content_size
        if said not in (zstandard.CONTENTSIZE_UNKNOWN, raw_bytes):
            raise CorruptError(f"{what}: declares {said} bytes, not {raw_bytes}")
        content = zstandard.ZstdDecompressor().decompress(
            frame, max_output_size=raw_bytes, read_across_frames=False, allow_extra_data=False
        )
    except zstandard.ZstdError as error:
        raise CorruptError(f"{what}: {error}") from error
    if len(content) != raw_bytes:
        raise CorruptError(f"{what}: {len(content)} bytes, not {raw_bytes}")
    return content


def symbols(planes: bytes, width: int) -> npt.NDArray[np.uint32]:
    """The unsigned numbers of `width` bytes of which each plane of `planes` holds one byte."""
    rows = np.frombuffer(planes, np.uint8).reshape(width, -1)
    numbers = rows[0] if width == 1 else np.ascontiguousarray(rows.T).view(f"<u{width}")[:, 0]
    wide: npt.NDArray[np.uint32] = numbers.astype(np.uint32)
    return wide


def unzigzag(numbers: npt.NDArray[np.uint32]) -> Ints:
    """0, 1, 2, 3, 4 ... as 0, -1, 1, -2, 2 ..."""
    wide = numbers.astype(np.int64)
    return (wide >> 1) ^ -(wide & 1)
