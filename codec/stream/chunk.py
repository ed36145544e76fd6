"""One (slice, layer) as bytes, decodable by itself; codec/FORMAT.md is the normative text.

Rule: any bytes give a Chunk or a CodecError, and nothing is allocated before its count is checked.
"""

from __future__ import annotations

import struct
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from codec.errors import CorruptError, InvalidError, UnsupportedError
from codec.profiles import compact, paper, raw
from codec.profiles.profile import Profile
from codec.profiles.quantise import Steps
from codec.slice import Slice
from codec.splats import MAX_SH_DEGREE, Splats, sh_count

MAGIC = b"SWGC"
VERSION = 1

MODE_INTRA = 0
"""Coding mode: the chunk needs nothing but itself. 1..255 are free for predicted modes."""

PROFILE_CODES = {Profile.RAW: 0, Profile.PAPER: 1, Profile.COMPACT: 2}
"""The number of a profile in the header."""

FLAG_START_OFFSETS = 1
"""Set when start offsets are stored; clear when all are zero."""

MAX_SPLATS_PER_CHUNK = 1 << 20
"""Gaussians in a chunk; bounds what a hostile header can make a reader allocate."""

# magic, version, mode, profile, flags, birth, count, layer, sh_degree, zero, body bytes
HEADER = struct.Struct("<4sBBBBiIBBHI")
HEADER_BYTES = HEADER.size
assert HEADER_BYTES == 24


@dataclass(frozen=True, slots=True)
class ChunkBounds:
    """What a chunk may hold; a reader that has a manifest takes `Manifest.chunk_bounds`."""

    max_splats: int = MAX_SPLATS_PER_CHUNK
    max_sh_degree: int = MAX_SH_DEGREE

    @property
    def max_bytes(self) -> int:
        """Bytes of the largest such chunk: full, all float32, with start offsets."""
        splat_bytes = 4 * (11 + 3 * sh_count(self.max_sh_degree)) + 1
        return HEADER_BYTES + compact.HEAD.size + self.max_splats * splat_bytes


ANY_CHUNK = ChunkBounds()
MAX_CHUNK_BYTES = ANY_CHUNK.max_bytes
"""The largest chunk there can be."""
assert MAX_CHUNK_BYTES == 248_512_584

_PROFILES = {code: profile for profile, code in PROFILE_CODES.items()}

_DECODERS: dict[Profile, Callable[[memoryview, int, int], Splats]] = {
    Profile.RAW: raw.decode_body,
    Profile.PAPER: paper.decode_body,
    Profile.COMPACT: compact.decode_body,
}


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


def encode_chunk(slice: Slice, layer: int, profile: Profile, steps: Steps | None = None) -> bytes:
    """The chunk of `slice`, not entropy-coded.

    `compact` permutes the Gaussians and their axes, and quantises by `steps`, or by steps that suit
    the slice alone; `paper` keeps the order and refuses what fp16 cannot hold; `raw` keeps
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
    if profile is Profile.RAW:
        body = raw.encode_body(slice.splats)
    elif profile is Profile.PAPER:
        body = paper.encode_body(slice.splats)
    else:
        body, order = compact.encode_body(slice.splats, steps)
        offsets = offsets[order]
    if flags:
        body += offsets.tobytes()
    head = HEADER.pack(
        MAGIC,
        VERSION,
        MODE_INTRA,
        PROFILE_CODES[profile],
        flags,
        slice.birth,
        count,
        layer,
        slice.splats.sh_degree,
        0,
        len(body),
    )
    return head + body


def read_header(data: bytes | memoryview) -> ChunkHeader:
    """The header at the start of `data`; the body may be absent.

    A CodecError says the place of the field that is wrong.
    """
    if len(data) < HEADER_BYTES:
        raise CorruptError(f"chunk: {len(data)} bytes are no header of {HEADER_BYTES}")
    magic, version, mode, profile, flags, birth, count, layer, sh_degree, zero, body_bytes = (
        HEADER.unpack_from(data)
    )
    if magic != MAGIC:
        raise CorruptError(f"chunk: starts with {bytes(magic)!r}, not {MAGIC!r}", 0)
    if version != VERSION:
        raise UnsupportedError(f"chunk: version {version}; this program reads {VERSION}", 4)
    if mode != MODE_INTRA:
        raise UnsupportedError(f"chunk: coding mode {mode}; this program reads {MODE_INTRA}", 5)
    if profile not in _PROFILES:
        raise UnsupportedError(f"chunk: profile {profile}; this program reads 0, 1 and 2", 6)
    if flags & ~FLAG_START_OFFSETS or zero:
        raise UnsupportedError("chunk: a reserved bit is set", 18 if zero else 7)
    if count > MAX_SPLATS_PER_CHUNK:
        raise CorruptError(f"chunk: {count} Gaussians, at most {MAX_SPLATS_PER_CHUNK}", 12)
    if sh_degree > MAX_SH_DEGREE:
        raise UnsupportedError(f"chunk: SH degree {sh_degree}, at most {MAX_SH_DEGREE}", 17)
    if HEADER_BYTES + body_bytes > MAX_CHUNK_BYTES:
        raise CorruptError(f"chunk: a body of {body_bytes} bytes", 20)
    return ChunkHeader(birth, layer, _PROFILES[profile], count, sh_degree, bool(flags), body_bytes)


def decode_chunk(data: bytes | memoryview, bounds: ChunkBounds = ANY_CHUNK) -> Chunk:
    """The chunk in `data`, which holds it exactly.

    Raises CorruptError or UnsupportedError for anything else. Memory beyond `data` is what the
    Gaussians take as float32, whose number `bounds` limits, and a few MB.
    """
    header = read_header(data)
    if header.count > bounds.max_splats:
        raise CorruptError(
            f"chunk: {header.count} Gaussians, where at most {bounds.max_splats} may be", 12
        )
    if header.sh_degree > bounds.max_sh_degree:
        raise CorruptError(
            f"chunk: SH degree {header.sh_degree}, where at most {bounds.max_sh_degree} may be", 17
        )
    body = memoryview(data)[HEADER_BYTES:]
    if len(body) != header.body_bytes:
        raise CorruptError(f"chunk: {len(body)} bytes after the header, not {header.body_bytes}")
    offset_bytes = header.count if header.has_start_offsets else 0
    if len(body) < offset_bytes:
        raise CorruptError("chunk: too short for its start offsets")
    attributes, tail = body[: len(body) - offset_bytes], body[len(body) - offset_bytes :]
    try:
        splats = _DECODERS[header.profile](attributes, header.count, header.sh_degree)
    except InvalidError as error:
        raise CorruptError(f"chunk: {error}") from error
    offsets = (
        np.frombuffer(tail, np.uint8).copy()
        if header.has_start_offsets
        else np.zeros(header.count, np.uint8)
    )
    return Chunk(header.birth, header.layer, header.profile, Slice(header.birth, splats, offsets))


def plane_edges(chunk: bytes) -> list[int]:
    """Offsets in `chunk`, from 0 to its end, between planes or attributes; none for `raw`."""
    header = read_header(chunk)
    if header.profile is Profile.RAW:
        return []
    body_end = len(chunk) - (header.count if header.has_start_offsets else 0)
    body = memoryview(chunk)[HEADER_BYTES:body_end]
    if header.profile is Profile.PAPER:
        inner = paper.plane_edges(header.count, header.sh_degree)
    else:
        inner = compact.plane_edges(body, header.count, header.sh_degree)
    # What the body begins with goes with the header of the chunk, which may be all there is.
    edges = {HEADER_BYTES + edge for edge in inner} - {HEADER_BYTES}
    return sorted({0, *edges, len(chunk)})
