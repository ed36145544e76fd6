"""The entropy coders: what a chunk's bytes become in an object, and back."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from enum import IntEnum

from codec.errors import CorruptError

from . import gzip, zstd
from .effort import Effort


@dataclass(frozen=True, slots=True)
class EncodedChunk:
    """The bytes of a chunk, and what an entropy coder should know of them."""

    birth: int
    data: bytes
    edges: Sequence[int]
    """Offsets in `data`, from 0 to its end, between planes or attributes; none if all of it is
    float32."""


class Coder(IntEnum):
    """How packets are coded: the number stands in the head of an object."""

    ZSTD = 1
    """The default of a writer."""

    GZIP = 2
    """For plain web servers: browsers inflate it with DecompressionStream."""


def coder_of(packet: bytes | memoryview) -> Coder:
    """The coder of `packet`, by its first bytes. Raises CorruptError if it is of none."""
    start = bytes(packet[:4])
    if start == zstd.MAGIC:
        return Coder.ZSTD
    if start == gzip.MAGIC:
        return Coder.GZIP
    raise CorruptError("packet: is neither a zstd frame nor a gzip member")


def compress(
    content: bytes,
    edges: Sequence[int] = (),
    coder: Coder = Coder.ZSTD,
    effort: Effort = Effort.USUAL,
) -> bytes:
    """`content` as one packet.

    `edges` are the offsets, from 0 to the end, between its byte planes; without any it is float32.
    """
    if coder is Coder.GZIP:
        return gzip.compress(content, edges, effort)
    return zstd.compress(content, edges, effort)


def with_start(packet: bytes, content: bytes) -> bytes | None:
    """The packet of `content`, which differs from that of `packet` in its head, with as many of the
    same bytes as its coder allows; None if that is none of them."""
    return zstd.with_start(packet, content) if coder_of(packet) is Coder.ZSTD else None


def decompress(packet: bytes | memoryview, limit_bytes: int) -> bytes:
    """The content of `packet`, which holds one packet of either coder exactly.

    Memory stays within the limit. Raises CorruptError.
    """
    if coder_of(packet) is Coder.GZIP:
        return gzip.decompress(packet, limit_bytes)
    return zstd.decompress(packet, limit_bytes)
