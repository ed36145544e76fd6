"""The entropy coder: zstd frames that say how much they hold, with a checksum.

A zstd block has one Huffman table for all its literals. A chunk is a row of planes with different
statistics, so the encoder ends a block where a new table pays; a decoder need not know.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import numpy as np
import zstandard

from .errors import CorruptError

PLANES_LEVEL = 19
"""zstd level for quantised planes: a chunk is encoded once and fetched often."""

FLOATS_LEVEL = 3
"""zstd level for float32, which hardly shrinks however long one tries."""

MIN_MATCH = 7
"""Shortest repeat looked for, in bytes: shorter ones in quantised planes are mere chance."""

MAX_JOINED_PLANES = 8
"""Planes tried in one block; bounds the work for chunks with many SH planes."""

MAX_EXPANSION = 1 << 15
"""zstd cannot inflate more: a block of 128 KiB takes 4 bytes at least."""

TABLE_BYTES = 12.0
TABLE_BYTES_PER_VALUE = 0.25
"""What a block with its Huffman table costs by reckoning: fixed, and per value up to the last."""


def _join_planes(content: memoryview, edges: Sequence[int]) -> list[int]:
    """Those of `edges` between which blocks cost least, by their entropy and their tables."""
    planes = [
        np.bincount(np.frombuffer(content[a:b], np.uint8), minlength=256)
        for a, b in pairwise(edges)
    ]
    totals = np.concatenate([np.zeros((1, 256), np.int64), np.cumsum(planes, axis=0)])
    cost = [0.0]
    origin = [0]
    for end in range(1, len(edges)):
        starts = np.arange(max(0, end - MAX_JOINED_PLANES), end)
        counts = (totals[end] - totals[starts]).astype(np.float64)
        sizes = counts.sum(axis=1)
        with np.errstate(divide="ignore", invalid="ignore"):
            bits = np.where(counts > 0, -counts * np.log2(counts / sizes[:, None]), 0).sum(axis=1)
        last_value = 256 - np.argmax(counts[:, ::-1] > 0, axis=1)
        coded = bits / 8 + TABLE_BYTES + TABLE_BYTES_PER_VALUE * last_value
        total = np.minimum(coded, sizes + 3) + [cost[start] for start in starts]
        best = int(np.argmin(total))
        cost.append(float(total[best]))
        origin.append(int(starts[best]))
    chosen = [len(edges) - 1]
    while chosen[-1]:
        chosen.append(origin[chosen[-1]])
    return [edges[i] for i in reversed(chosen)]


def compress(content: bytes, edges: Sequence[int] = ()) -> bytes:
    """`content` as one zstd frame.

    `edges` are the offsets, from 0 to the end, between its byte planes; without any it is float32.
    """
    if not edges or not content:
        return zstandard.ZstdCompressor(level=FLOATS_LEVEL, write_checksum=True).compress(content)
    parameters = zstandard.ZstdCompressionParameters.from_level(
        PLANES_LEVEL, source_size=len(content), min_match=MIN_MATCH, write_checksum=True
    )
    compressor = zstandard.ZstdCompressor(compression_params=parameters).compressobj(len(content))
    view = memoryview(content)
    cuts = _join_planes(view, sorted(set(edges)))
    parts = []
    for start, end in pairwise(cuts):
        parts.append(compressor.compress(view[start:end]))
        if end < len(content):
            parts.append(compressor.flush(zstandard.COMPRESSOBJ_FLUSH_BLOCK))
    parts.append(compressor.flush(zstandard.COMPRESSOBJ_FLUSH_FINISH))
    return b"".join(parts)


def content_bytes(frame: bytes | memoryview, limit_bytes: int) -> int:
    """What `frame` says it decompresses to. Raises CorruptError if unsaid or over the limit."""
    try:
        parameters = zstandard.get_frame_parameters(frame)
    except zstandard.ZstdError as error:
        raise CorruptError("frame: no zstd frame") from error
    size = int(parameters.content_size)
    if parameters.content_size in (zstandard.CONTENTSIZE_UNKNOWN, zstandard.CONTENTSIZE_ERROR):
        raise CorruptError("frame: does not say its content size")
    if size > MAX_EXPANSION * len(frame):
        raise CorruptError(f"frame: {size} bytes of content cannot come from {len(frame)}")
    if size > limit_bytes:
        raise CorruptError(f"frame: {size} bytes of content, at most {limit_bytes}")
    if not parameters.has_checksum or parameters.dict_id:
        raise CorruptError("frame: no checksum, or a dictionary")
    return size


def decompress(frame: bytes | memoryview, limit_bytes: int) -> bytes:
    """The content of `frame`, which holds one frame exactly. Memory stays within the limit."""
    size = content_bytes(frame, limit_bytes)
    try:
        content = zstandard.ZstdDecompressor().decompress(
            frame, read_across_frames=False, allow_extra_data=False
        )
    except zstandard.ZstdError as error:
        raise CorruptError(f"frame: {error}") from error
    if len(content) != size:
        raise CorruptError(f"frame: {len(content)} bytes of content, not {size}")
    return content
