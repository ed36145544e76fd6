"""gzip members that say how much they hold, with a checksum: what browsers inflate by themselves.

Rule: nothing is inflated before the member's own trailer has said how much it holds, and never
more than that.
"""

from __future__ import annotations

import io
import struct
import zlib
from collections.abc import Sequence
from itertools import pairwise

from codec.errors import CorruptError

from .blocks import divisions
from .effort import Effort

MAGIC = b"\x1f\x8b\x08\x00"
"""gzip, deflate, and no flag: neither name nor comment nor anything else in the head."""

HEAD = MAGIC + bytes(4) + b"\x02\xff"
"""No time, the best compression, no system: the same bytes wherever it is written."""

# CRC-32 of the content, its size
TRAILER = struct.Struct("<II")

LEVEL = 9
MEMORY_LEVEL = 9
"""zlib's largest: blocks end where we say, not where its buffer is full."""

STRATEGIES = (zlib.Z_RLE, zlib.Z_FILTERED, zlib.Z_DEFAULT_STRATEGY)
"""All are tried: repeats in quantised planes are mostly chance, those in float32 are not."""

MAX_EXPANSION = 1032
"""deflate cannot inflate more: 258 bytes take two bits at least."""

PIECE_BYTES = 1 << 18
"""Inflated at a time, so that the content is held once."""


def _deflate(content: memoryview, cuts: Sequence[int], strategy: int) -> bytes:
    stream = zlib.compressobj(LEVEL, zlib.DEFLATED, -zlib.MAX_WBITS, MEMORY_LEVEL, strategy)
    parts = []
    for start, end in pairwise(cuts):
        parts.append(stream.compress(content[start:end]))
        if end < len(content):
            parts.append(stream.flush(zlib.Z_BLOCK))
    parts.append(stream.flush())
    return b"".join(parts)


def compress(content: bytes, edges: Sequence[int] = (), effort: Effort = Effort.USUAL) -> bytes:
    """`content` as one gzip member.

    `edges` are the offsets, from 0 to the end, between its byte planes; without any it is float32.
    Effort.QUICK takes as long as Effort.USUAL.
    """
    view = memoryview(content)
    ways = divisions(view, edges, effort) if edges and content else [(0, len(content))]
    deflated = min(
        (_deflate(view, cuts, strategy) for cuts in ways for strategy in STRATEGIES), key=len
    )
    return HEAD + deflated + TRAILER.pack(zlib.crc32(content), len(content))


def content_bytes(packet: bytes | memoryview, limit_bytes: int) -> int:
    """Declared content size of `packet`, bytes. Raises CorruptError if wrong or over the limit."""
    if len(packet) < len(HEAD) + TRAILER.size or packet[: len(MAGIC)] != MAGIC:
        raise CorruptError("packet: is not a gzip member without flags")
    size = int(TRAILER.unpack_from(packet, len(packet) - TRAILER.size)[1])
    if size > MAX_EXPANSION * len(packet):
        raise CorruptError(f"packet: {size} bytes of content cannot come from {len(packet)}")
    if size > limit_bytes:
        raise CorruptError(f"packet: {size} bytes of content, at most {limit_bytes}")
    return size


def decompress(packet: bytes | memoryview, limit_bytes: int) -> bytes:
    """The content of `packet`, which holds one member exactly. Memory stays within the limit."""
    size = content_bytes(packet, limit_bytes)
    stream = zlib.decompressobj(16 + zlib.MAX_WBITS)  # which checks the trailer
    content = io.BytesIO()
    view = memoryview(packet)
    try:
        for start in range(0, len(view), PIECE_BYTES):
            pending: bytes | memoryview = view[start : start + PIECE_BYTES]
            while pending and not stream.eof:
                room = size + 1 - content.tell()
                content.write(stream.decompress(pending, min(room, PIECE_BYTES)))
                if content.tell() > size:
                    raise CorruptError(
                        f"packet: more content than the {size} bytes that it declares"
                    )
                pending = stream.unconsumed_tail
            if stream.eof and (stream.unused_data or start + PIECE_BYTES < len(view)):
                raise CorruptError("packet: something follows the gzip member")
    except zlib.error as error:
        raise CorruptError(f"packet: {error}") from error
    if not stream.eof:
        raise CorruptError("packet: ends inside the gzip member")
    return content.getvalue()
