"""One (slice, layer) as bytes, decodable by itself; codec/FORMAT.md is the normative text.

Rule: any bytes give a Chunk or a CodecError, and nothing is allocated before its count is checked.
"""

from __future__ import annotations

import struct
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from codec.coders.coder import EncodedChunk
from codec.errors import CorruptError, InvalidError, UnsupportedError
from codec.profiles import compact, raw
from codec.profiles.profile import PROFILE_OF_CODE, Profile
from codec.profiles.quantise import Steps
from codec.slice import Slice
from codec.splats import MAX_SH_DEGREE

MAGIC = b"SWGC"
VERSION = 1

MODE_INTRA = 0
"""Coding mode: the chunk needs nothing but itself. 1..255 are free for predicted modes."""

FLAG_START_OFFSETS = 1
"""Set when start offsets are stored; clear when all are zero."""

MAX_SPLATS_PER_CHUNK = 1 << 20
"""Gaussians in a chunk; bounds what a hostile header can make a reader allocate."""

# magic, version, mode, profile, flags, birth, count, layer, sh_degree, zero, body bytes
HEADER = struct.Struct("<4sBBBBiIBBHI")
HEADER_BYTES = HEADER.size
assert HEADER_BYTES == 24

PROFILE_OFFSET = 6
BIRTH_OFFSET = 8
COUNT_OFFSET = 12
LAYER_OFFSET = 16
SH_DEGREE_OFFSET = 17
"""Where in a chunk these fields lie."""


@dataclass(frozen=True, slots=True)
class ChunkBounds:
    """What a chunk may hold; a reader that has a manifest takes `Manifest.chunk_bounds`."""

    max_splats: int = MAX_SPLATS_PER_CHUNK
    max_sh_degree: int = MAX_SH_DEGREE

    @property
    def max_bytes(self) -> int:
        """Bytes of the largest such chunk: full, all float32, with start offsets."""
        splat_bytes = raw.bytes_per_gaussian(self.max_sh_degree) + 1
        return HEADER_BYTES + compact.HEAD.size + self.max_splats * splat_bytes


ANY_CHUNK = ChunkBounds()
MAX_CHUNK_BYTES = ANY_CHUNK.max_bytes
"""The largest chunk there can be."""
assert MAX_CHUNK_BYTES == 248_512_584


@dataclass(frozen=True, slots=True)
class Chunk:
    """A decoded chunk: one layer of the slice due at `birth`."""

    birth: int
    layer: int
    profile: Profile
    slice: Slice


@dataclass(frozen=True, slots=True)
class ChunkHeader:
    """The fixed first HEADER_BYTES of a chunk, checked."""

    birth: int
    layer: int
    profile: Profile
    count: int
    sh_degree: int
    has_start_offsets: bool
    body_bytes: int


def encode_chunk(
    slice: Slice, layer: int, profile: Profile, steps: Steps | None = None
) -> EncodedChunk:
    """The chunk of `slice`, not entropy-coded.

    `compact` permutes the Gaussians and their axes, and quantises by `steps`, or by steps that suit
    these Gaussians. `paper` keeps the order and refuses what fp16 cannot hold. `raw` keeps
    everything as it is.
    """
    count = len(slice.splats)
    if count > MAX_SPLATS_PER_CHUNK:
        raise InvalidError(f"chunk: {count} Gaussians, at most {MAX_SPLATS_PER_CHUNK}")
    if not 0 <= layer <= 255:
        raise InvalidError(f"chunk: layer {layer} is not in 0..255")
    if not -(1 << 31) <= slice.birth < 1 << 31:
        raise InvalidError(f"chunk: birth {slice.birth} does not fit 32 bits")
    offsets = slice.start_offsets
    flags = FLAG_START_OFFSETS if offsets.any() else 0
    body = profile.coding.encode(slice.splats, steps)
    if body.order is not None:
        offsets = offsets[body.order]
    tail = offsets.tobytes() if flags else b""
    head = HEADER.pack(
        MAGIC,
        VERSION,
        MODE_INTRA,
        profile.coding.CODE,
        flags,
        slice.birth,
        count,
        layer,
        slice.splats.sh_degree,
        0,
        len(body.data) + len(tail),
    )
    data = head + body.data + tail
    return EncodedChunk(slice.birth, data, _chunk_edges(body.edges, len(data)))


def encoded_elsewhere(data: bytes) -> EncodedChunk:
    """The chunk in `data`, which can be decoded, to be compressed once more."""
    header = read_header(data)
    end = len(data) - (header.count if header.has_start_offsets else 0)
    body = memoryview(data)[HEADER_BYTES:end]
    edges = header.profile.coding.edges(body, header.count, header.sh_degree)
    return EncodedChunk(header.birth, data, _chunk_edges(edges, len(data)))


def _chunk_edges(body_edges: Sequence[int], chunk_bytes: int) -> Sequence[int]:
    """The edges of a chunk of `chunk_bytes`, given those of its body."""
    if not body_edges:
        return ()
    # The header of the chunk and the first part of the body are one part.
    inner = {HEADER_BYTES + edge for edge in body_edges} - {HEADER_BYTES}
    return sorted({0, *inner, chunk_bytes})


def read_header(data: bytes | memoryview) -> ChunkHeader:
    """The header at the start of `data`; the body may be absent.

    A CodecError says the place of the field that is wrong.
    """
    if len(data) < HEADER_BYTES:
        raise CorruptError(f"chunk: {len(data)} bytes are too few for a header of {HEADER_BYTES}")
    magic, version, mode, profile, flags, birth, count, layer, sh_degree, zero, body_bytes = (
        HEADER.unpack_from(data)
    )
    if magic != MAGIC:
        raise CorruptError(f"chunk: starts with {bytes(magic)!r}, not {MAGIC!r}", 0)
    if version != VERSION:
        raise UnsupportedError(f"chunk: version {version}; this program reads {VERSION}", 4)
    if mode != MODE_INTRA:
        raise UnsupportedError(f"chunk: coding mode {mode}; this program reads {MODE_INTRA}", 5)
    if profile not in PROFILE_OF_CODE:
        known = ", ".join(f"{code} ({known.value})" for code, known in PROFILE_OF_CODE.items())
        message = f"chunk: profile {profile}; this program reads {known}"
        raise UnsupportedError(message, PROFILE_OFFSET)
    if flags & ~FLAG_START_OFFSETS or zero:
        raise UnsupportedError("chunk: a reserved bit is set", 18 if zero else 7)
    if count > MAX_SPLATS_PER_CHUNK:
        raise CorruptError(
            f"chunk: {count} Gaussians, at most {MAX_SPLATS_PER_CHUNK}", COUNT_OFFSET
        )
    if sh_degree > MAX_SH_DEGREE:
        message = f"chunk: SH degree {sh_degree}, at most {MAX_SH_DEGREE}"
        raise UnsupportedError(message, SH_DEGREE_OFFSET)
    if HEADER_BYTES + body_bytes > MAX_CHUNK_BYTES:
        raise CorruptError(f"chunk: a body of {body_bytes} bytes", 20)
    return ChunkHeader(
        birth, layer, PROFILE_OF_CODE[profile], count, sh_degree, bool(flags), body_bytes
    )


def decode_chunk(data: bytes | memoryview, bounds: ChunkBounds = ANY_CHUNK) -> Chunk:
    """The chunk in `data`, which holds it exactly.

    Raises CorruptError or UnsupportedError for anything else. Memory beyond `data` is what the
    Gaussians take as float32, whose number `bounds` limits, and a few MB.
    """
    header = read_header(data)
    if header.count > bounds.max_splats:
        raise CorruptError(
            f"chunk: {header.count} Gaussians, where at most {bounds.max_splats} may be",
            COUNT_OFFSET,
        )
    if header.sh_degree > bounds.max_sh_degree:
        raise CorruptError(
            f"chunk: SH degree {header.sh_degree}, where at most {bounds.max_sh_degree} may be",
            SH_DEGREE_OFFSET,
        )
    body = memoryview(data)[HEADER_BYTES:]
    if len(body) != header.body_bytes:
        raise CorruptError(f"chunk: {len(body)} bytes after the header, not {header.body_bytes}")
    offset_bytes = header.count if header.has_start_offsets else 0
    if len(body) < offset_bytes:
        raise CorruptError("chunk: too short for its start offsets")
    attributes, tail = body[: len(body) - offset_bytes], body[len(body) - offset_bytes :]
    try:
        splats = header.profile.coding.decode(attributes, header.count, header.sh_degree)
    except InvalidError as error:
        raise CorruptError(f"chunk: {error}") from error
    offsets = (
        np.frombuffer(tail, np.uint8).copy()
        if header.has_start_offsets
        else np.zeros(header.count, np.uint8)
    )
    return Chunk(header.birth, header.layer, header.profile, Slice(header.birth, splats, offsets))
