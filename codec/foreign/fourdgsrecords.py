"""The records of a .4dgs file (avala-ai/4dgs, version 1, model `keyframe-delta`), and the streams
of integers in them. Everything is little-endian.

    file      magic, records, magic
    record    u8 kind, u64 bytes, content; a reader passes over kinds that it does not know
    header    texts profile and library, f64 duration_s, u64 Gaussians, f64 cutoff, text model,
              f64 x 6 bounds, u8 SH degree, u8 flags, ...
    grids     text scheme, f64 x 3 origin, f64 x 8 steps: position, ln size, rotation, colour,
              opacity, motion, time, ln sigma; ...
    windows   u32 count, for each f64 lo, hi
    keyframe  f64 t0, t1, u32 level, u32 count, text codec, u64 raw bytes, block of streams
    delta     f64 t0, t1, u32 level, u8 mode, u64 offset of its reference, u64 offset of its
              keyframe, u16 depth, u32 x 3 updates, births, deaths, text codec, u64 raw bytes, block
              of three blocks of streams
    band      u8 band, a stream: harmonics of a keyframe, or of a delta's births, that goes before
    stream    u8 attribute, u8 width, u8 mode (0 raw, 1 differences, 2 constant), u8 codec (0
              deflate, 1 zstd), u8 channels, u32 count, u64 bytes, payload: byte planes of zigzag
"""

from __future__ import annotations

import math
import struct
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from codec.errors import CorruptError, UnsupportedError
from codec.files import opened_regular, read_span
from codec.splats import MAX_SH_DEGREE

from .bytecursor import ByteCursor
from .limits import check_ratio
from .notes import notes
from .packed import WIDTHS, Ints, inflated, symbols, unzigzag, unzstd

MAGIC = b"\x894DGS1\r\n"
MODEL, SCHEME = "keyframe-delta", "uniform-v1"
RECORD = struct.Struct("<BQ")
HEADER, FOOTER, GRIDS, WINDOWS, KEYFRAME, BAND, DELTA = 0x01, 0x02, 0x03, 0x04, 0x05, 0x07, 0x10
COORDINATE_FRAME, OBJECT_TRACK = 0x20, 0x25
STREAM = struct.Struct("<BBBBBIQ")
RAW, DIFFERENCES, CONSTANT = range(3)
DEFLATE, ZSTD = range(2)
CODECS = {"": None, "deflate": DEFLATE, "zstd": ZSTD}
SPAN = struct.Struct("<2d")
KEYFRAME_HEAD = struct.Struct("<2d2I")
DELTA_HEAD = struct.Struct("<2dIBQQH3I")
POSITION, SIZE, LARGEST, ROTATION, COLOUR, OPACITY = range(6)
MOTION, TIME, SIGMA, FLAGS, WINDOW = range(6, 11)
ID = 13
CHANNELS = {
    **{POSITION: 3, SIZE: 3, LARGEST: 1, ROTATION: 3, COLOUR: 3, OPACITY: 1},
    **{MOTION: 3, TIME: 1, SIGMA: 1, FLAGS: 1, WINDOW: 1, ID: 1},
}
"""Numbers of each attribute that is read."""
MAX_STATES = 1 << 20
MAX_FRONT_BYTES = 1 << 20
"""Longest header, grids or table of windows."""
MAX_BLOCK_BYTES = 1 << 30
"""Longest keyframe or delta."""
BIN = np.iinfo(np.int32)

Streams = dict[int, Ints]
"""(N, channels) of each attribute."""


def band_channels(band: int) -> int:
    return 3 * (2 * band + 1)


@dataclass(frozen=True, slots=True)
class Span:
    """Where the content of a record lies in the file."""

    offset: int
    num_bytes: int


@dataclass(slots=True)
class StateRecord:
    """The head of a keyframe or a delta."""

    offset: int
    """Of the record."""
    content: Span
    t0_s: float
    t1_s: float
    reference: int | None
    """Offset of the record that a delta follows on; None for a keyframe."""
    bands: list[Span] = field(default_factory=list)


@dataclass(slots=True)
class Contents:
    """The contents of a file, without the states themselves."""

    cutoff: float = 0.0
    sh_degree: int = 0
    origin: tuple[float, ...] = ()
    steps: tuple[float, ...] = ()
    windows: list[tuple[float, float]] = field(default_factory=list)
    states: list[StateRecord] = field(default_factory=list)


def read_contents(path: Path) -> Contents:
    """The contents of the .4dgs file at `path`. Raises CorruptError, or UnsupportedError for
    another model than keyframe-delta, and for objects that move as one."""
    found = Contents()
    seen: set[int] = set()
    with opened_regular(path) as file:
        file_bytes = file.seek(0, 2)
        at = len(MAGIC)
        while at + RECORD.size <= file_bytes:
            file.seek(at)
            kind, num_bytes = RECORD.unpack(file.read(RECORD.size))
            span = Span(at + RECORD.size, num_bytes)
            if span.offset + num_bytes > file_bytes:
                raise CorruptError(f".4dgs: the record at {at} ends after the file")
            if kind in (HEADER, GRIDS, WINDOWS):
                if num_bytes > MAX_FRONT_BYTES:
                    raise CorruptError(f".4dgs: the record at {at} has {num_bytes} bytes")
                _take_front(found, kind, ByteCursor(file.read(num_bytes), f".4dgs: record at {at}"))
            elif kind in (KEYFRAME, DELTA):
                if not {HEADER, GRIDS} <= seen:
                    raise CorruptError(f".4dgs: the state at {at} comes before what it needs")
                _take_state(found, at, span, kind == DELTA, file.read(DELTA_HEAD.size))
            elif kind == BAND and found.states:
                found.states[-1].bands.append(span)
            elif kind == COORDINATE_FRAME:
                notes().say("names a coordinate frame, which is not read: it may be turned")
            elif kind == OBJECT_TRACK:
                raise UnsupportedError(".4dgs: objects that move as one are not read")
            elif kind == FOOTER:
                break
            seen.add(kind)
            at = span.offset + num_bytes
    if not found.states:
        raise CorruptError(".4dgs: has no states")
    return found


def _take_front(found: Contents, kind: int, cursor: ByteCursor) -> None:
    if kind == HEADER:
        cursor.text(), cursor.text()
        found.cutoff = cursor.fields(struct.Struct("<dQd"))[2]
        if (model := cursor.text()) != MODEL:
            raise UnsupportedError(f".4dgs: the model {model[:40]!r}; this program reads {MODEL}")
        *_, found.sh_degree, _ = cursor.fields(struct.Struct("<6dBB"))
        if found.sh_degree > MAX_SH_DEGREE or not 0 < found.cutoff <= 1:
            raise CorruptError(".4dgs: the header holds a number out of range")
    elif kind == GRIDS:
        if (scheme := cursor.text()) != SCHEME:
            raise UnsupportedError(f".4dgs: the grids {scheme[:40]!r}; this program reads {SCHEME}")
        found.origin = cursor.fields(struct.Struct("<3d"))
        found.steps = cursor.fields(struct.Struct("<8d"))
        if not all(map(math.isfinite, found.origin + found.steps)) or min(found.steps) <= 0:
            raise CorruptError(".4dgs: a grid without a finite step")
    else:
        (count,) = cursor.fields(struct.Struct("<I"))
        table = cursor.take(count * SPAN.size)
        found.windows = list(SPAN.iter_unpack(table))


def _take_state(found: Contents, at: int, span: Span, is_delta: bool, head: bytes) -> None:
    cursor = ByteCursor(head[: span.num_bytes], f".4dgs: state at {at}")
    t0_s, t1_s, *others = cursor.fields(DELTA_HEAD if is_delta else KEYFRAME_HEAD)
    before = found.states[-1].t1_s if found.states else 0.0
    if t0_s != before or not t0_s < t1_s < math.inf:
        raise CorruptError(f".4dgs: the state at {at} shows from {t0_s} to {t1_s} s after {before}")
    if len(found.states) >= MAX_STATES:
        raise CorruptError(f".4dgs: more than {MAX_STATES} states")
    reference = others[2] if is_delta else None
    found.states.append(StateRecord(at, span, t0_s, t1_s, reference))


def read_content(path: Path, span: Span, what: str) -> ByteCursor:
    """The content of a record. Raises CorruptError."""
    if span.num_bytes > MAX_BLOCK_BYTES:
        raise CorruptError(f"{what}: {span.num_bytes} bytes, at most {MAX_BLOCK_BYTES}")
    return ByteCursor(read_span(path, span.offset, span.num_bytes), what)


def read_block(cursor: ByteCursor, what: str) -> bytes | memoryview:
    """The block that ends a keyframe or a delta, unpacked. Raises CorruptError, or
    UnsupportedError."""
    codec = cursor.text()
    (raw_bytes,) = cursor.fields(struct.Struct("<Q"))
    block = cursor.block()
    if codec not in CODECS:
        raise UnsupportedError(f"{what}: packed by {codec[:40]!r}")
    check_ratio(what, raw_bytes, len(block))
    return _unpacked(block, CODECS[codec], raw_bytes, what)


def _unpacked(data: memoryview, codec: int | None, raw_bytes: int, what: str) -> bytes | memoryview:
    if raw_bytes > MAX_BLOCK_BYTES:
        raise CorruptError(f"{what}: claims to unpack to {raw_bytes} bytes")
    if codec is None:
        if len(data) != raw_bytes:
            raise CorruptError(f"{what}: {len(data)} bytes, not {raw_bytes}")
        return data
    return (inflated if codec == DEFLATE else unzstd)(data, raw_bytes, what)


def read_stream(
    cursor: ByteCursor, count: int, channels: int | None, what: str
) -> tuple[int, Ints]:
    """The attribute of the next stream, and its (count, channels) numbers; channels: None for those
    that the attribute has, if it is known, else no numbers. Raises CorruptError, or
    UnsupportedError."""
    kind, width, mode, codec, wide, rows, num_bytes = cursor.fields(STREAM)
    payload = cursor.take(num_bytes)
    channels = CHANNELS.get(kind) if channels is None else channels
    if channels is None:
        return kind, np.zeros((0, 1), np.int64)
    what = f"{what}: attribute {kind}"
    if (rows, wide) != (count, channels):
        raise CorruptError(f"{what}: {rows} x {wide} numbers, not {count} x {channels}")
    if codec not in (DEFLATE, ZSTD):
        raise UnsupportedError(f"{what}: packed by codec {codec}")
    if width not in WIDTHS or mode not in (RAW, DIFFERENCES, CONSTANT):
        raise CorruptError(f"{what}: numbers of {width} bytes in mode {mode}")
    if not count:
        return kind, np.zeros((0, channels), np.int64)
    stored = 1 if mode == CONSTANT else count
    planes = bytes(_unpacked(payload, codec, stored * channels * width, what))
    numbers = unzigzag(symbols(planes, width)).reshape(stored, channels)
    if mode == CONSTANT:
        numbers = np.repeat(numbers, count, axis=0)
    elif mode == DIFFERENCES:
        numbers = np.cumsum(numbers, axis=0, dtype=np.int64)
    return kind, numbers


def read_streams(block: bytes | memoryview, count: int, what: str) -> tuple[Ints, Streams]:
    """The (N,) identities and the other streams of a group of `count` Gaussians; no identity may
    come twice. Raises CorruptError, or UnsupportedError."""
    cursor, streams = ByteCursor(block, what), Streams()
    while cursor.left:
        kind, numbers = read_stream(cursor, count, None, what)
        if kind in streams:
            raise CorruptError(f"{what}: attribute {kind} comes twice")
        if kind in CHANNELS:
            streams[kind] = numbers
    ids = streams.pop(ID, np.zeros((0, 1), np.int64))[:, 0]
    if len(ids) != count:
        raise CorruptError(f"{what}: {count} Gaussians without identities")
    if len(ids) and (ids.min() < BIN.min or ids.max() > BIN.max):
        raise CorruptError(f"{what}: an identity out of range")
    if len(np.unique(ids)) != count:
        raise CorruptError(f"{what}: an identity comes twice")
    return ids, streams
