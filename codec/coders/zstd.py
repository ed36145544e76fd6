"""zstd frames that say how much they hold, with a checksum."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import zstandard

from codec.errors import CorruptError

from .blocks import Effort, divisions

MAGIC = b"\x28\xb5\x2f\xfd"

PLANES_LEVEL = 19
"""zstd level for quantised planes: a chunk is encoded once and fetched often."""

QUICK_LEVEL = 1
"""The same for a live stream, whose viewers wait for the encoder: 5 to 40 times as fast, for 14 %
more bytes at most, of keyframes 2 %."""

FLOATS_LEVEL = 3
"""zstd level for float32, which hardly shrinks however long one tries."""

MIN_MATCH = 7
"""Shortest repeat looked for, in bytes: shorter ones in quantised planes are mere chance."""

BLOCK_HEAD, CHECKSUM = 3, 4
"""Bytes before each block, and behind the last one."""

REPEATED, COMPRESSED = 1, 2
"""Kinds of blocks (RFC 8878: RLE and compressed); a block of the third kind is raw."""

MAX_EXPANSION = 1 << 15
"""zstd cannot inflate more: a block of 128 KiB takes 4 bytes at least."""


def compress(content: bytes, edges: Sequence[int] = (), effort: Effort = Effort.USUAL) -> bytes:
    """`content` as one zstd frame.

    `edges` are the offsets, from 0 to the end, between its byte planes; without any it is float32.
    """
    if not edges or not content:
        return zstandard.ZstdCompressor(level=FLOATS_LEVEL, write_checksum=True).compress(content)
    level = QUICK_LEVEL if effort is Effort.QUICK else PLANES_LEVEL
    view = memoryview(content)
    ways = divisions(view, edges, effort)
    return min((_compress_blocks(view, cuts, level) for cuts in ways), key=len)


def _compress_blocks(
    content: memoryview, cuts: Sequence[int], level: int, goes_on: bool = False
) -> bytes:
    """goes_on: leaves out the end of the frame, behind the last cut."""
    parameters = zstandard.ZstdCompressionParameters.from_level(
        level, source_size=len(content), min_match=MIN_MATCH, write_checksum=True
    )
    compressor = zstandard.ZstdCompressor(compression_params=parameters).compressobj(len(content))
    parts = []
    for start, end in pairwise(cuts):
        parts.append(compressor.compress(content[start:end]))
        if end < len(content):
            parts.append(compressor.flush(zstandard.COMPRESSOBJ_FLUSH_BLOCK))
    if not goes_on:
        parts.append(compressor.flush(zstandard.COMPRESSOBJ_FLUSH_FINISH))
    return b"".join(parts)


def with_start(packet: bytes, content: bytes) -> bytes | None:
    """The packet of `content`, which differs from that of `packet` in its first block alone: the
    other blocks are copied. None where these refer to what the first block was, as they may."""
    at = zstandard.frame_header_size(packet)
    head = int.from_bytes(packet[at : at + BLOCK_HEAD], "little")
    is_last, kind, size = head & 1, head >> 1 & 3, head >> 3
    end = at + BLOCK_HEAD + (1 if kind == REPEATED else size)
    if kind == COMPRESSED:
        size = len(zstandard.ZstdDecompressor().decompressobj().decompress(packet[:end]))
    start = _compress_blocks(memoryview(content), (0, size), PLANES_LEVEL, size < len(content))
    start = start[zstandard.frame_header_size(start) :]
    if is_last:
        start = start[:-CHECKSUM]
    checked = zstandard.ZstdCompressor(level=1, write_checksum=True).compress(content)
    made = packet[:at] + start + packet[end:-CHECKSUM] + checked[-CHECKSUM:]
    try:
        return made if decompress(made, len(content)) == content else None
    except CorruptError:
        return None


def content_bytes(packet: bytes | memoryview, limit_bytes: int) -> int:
    """Declared content size of `packet`, bytes. Raises CorruptError if unsaid or over the limit."""
    if packet[: len(MAGIC)] != MAGIC:
        raise CorruptError("packet: is not a zstd frame")
    try:
        parameters = zstandard.get_frame_parameters(packet)
    except zstandard.ZstdError as error:
        raise CorruptError("packet: is not a whole zstd frame") from error
    size = int(parameters.content_size)
    if parameters.content_size in (zstandard.CONTENTSIZE_UNKNOWN, zstandard.CONTENTSIZE_ERROR):
        raise CorruptError("packet: does not declare its content size")
    if size > MAX_EXPANSION * len(packet):
        raise CorruptError(f"packet: {size} bytes of content cannot come from {len(packet)}")
    if size > limit_bytes:
        raise CorruptError(f"packet: {size} bytes of content, at most {limit_bytes}")
    if not parameters.has_checksum or parameters.dict_id:
        raise CorruptError("packet: has no checksum, or needs a dictionary")
    return size


def decompress(packet: bytes | memoryview, limit_bytes: int) -> bytes:
    """The content of `packet`, which holds one packet exactly. Memory stays within the limit."""
    size = content_bytes(packet, limit_bytes)
    try:
        content = zstandard.ZstdDecompressor().decompress(
            packet, read_across_frames=False, allow_extra_data=False
        )
    except zstandard.ZstdError as error:
        raise CorruptError(f"packet: {error}") from error
    if len(content) != size:
        raise CorruptError(f"packet: {len(content)} bytes of content, not {size}")
    return content
