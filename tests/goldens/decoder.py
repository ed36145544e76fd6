"""A decoder of chunks, written from codec/FORMAT.md alone: slow and plain.

It shares no code with the package; `f32` is Math.fround in a browser. Bytes that FORMAT.md calls
corrupt fail an assertion.
"""

from __future__ import annotations

import enum
import math
import struct
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import chain, pairwise

KEPT, ENDED, PREDICTED, NEW = range(4)
SKIP_MAP, CHANGE, KEYFRAME = range(3)

Statuses = list[list[int]]
"""The statuses of a slice: one for each slot of each layer."""


class Unsupported(AssertionError):
    """The bytes may be valid, but this version does not define their meaning."""


class Hole(enum.Enum):
    """State of a slot without a Gaussian."""

    EMPTY = "empty"
    UNKNOWN = "unknown"


@dataclass(frozen=True, slots=True)
class Lattice:
    """The steps as f32."""

    position_m: float
    log_scale: float
    log_scale_base: float
    rotation: float
    colour: float
    opacity_levels: int


@dataclass(frozen=True, slots=True)
class Shape:
    """Data from the manifest that chunks do not contain."""

    swin_size: int
    segment_frames: int
    num_coefficients: int
    slots: tuple[int, ...]
    lattice: tuple[Lattice, ...]


@dataclass(frozen=True, slots=True)
class Floats:
    mean: tuple[float, ...]
    log_scales: tuple[float, ...]
    quat: tuple[float, ...]
    logit_opacity: float
    sh: tuple[tuple[float, ...], ...]


@dataclass(frozen=True, slots=True)
class Gaussian:
    start: int  # the frame from which it shows
    position: tuple[int, ...]
    attributes: tuple[int, ...]  # scales, turns, y, u, v, opacity
    escaped: Floats | None = None  # then the integers have no meaning


Slot = Gaussian | Hole


# --- Section 8: lattice ---


def f32(value: float) -> float:
    """`value` rounded to the nearest float32; infinite if it is too large."""
    try:
        rounded: float = struct.unpack("<f", struct.pack("<f", value))[0]
    except OverflowError:
        return math.copysign(math.inf, value)
    return rounded


def logit(level: int, levels: int) -> float:
    if level in (0, levels - 1):
        return 16.0 if level else -16.0
    return f32(math.log(level / (levels - 1 - level)))


def in_lattice(position: Sequence[int]) -> bool:
    return all(-(2**23) < q < 2**23 for q in position)


def to_floats(gaussian: Gaussian, lattice: Lattice) -> Floats:
    if gaussian.escaped is not None:
        return gaussian.escaped
    attributes = gaussian.attributes
    k = (len(attributes) - 7) // 3
    mean = tuple(f32(q * lattice.position_m) for q in gaussian.position)
    base = lattice.log_scale_base
    scales = tuple(f32(f32(a * lattice.log_scale) + base) for a in attributes[:3])
    x, y, z = (f32(r * lattice.rotation) for r in attributes[3:6])
    square = f32(f32(f32(x * x) + f32(y * y)) + f32(z * z))
    w = f32(math.sqrt(max(f32(1 - square), 0.0)))
    colours = [f32(c * lattice.colour) for c in attributes[6:-1]]
    sh = []
    for luma, co, cg in zip(colours[:k], colours[k : 2 * k], colours[2 * k :], strict=True):
        rest = f32(luma - cg)
        sh.append((f32(rest + co), f32(luma + cg), f32(rest - co)))
    opacity = logit(attributes[-1], lattice.opacity_levels)
    return Floats(mean, scales, (w, x, y, z), opacity, tuple(sh))


# --- Section 9: skip map ---


@dataclass(frozen=True, slots=True)
class Head:
    layer: int
    has_starts: bool
    birth: int


def decode_head(chunk: bytes, kind: int, shape: Shape) -> Head:
    """The first 12 bytes of a chunk in the place of one of this kind."""
    assert len(chunk) >= 12
    magic, found, layer, flags, zero, birth = struct.unpack_from("<4sBBBBi", chunk)
    assert magic == b"SWG1"
    if found > KEYFRAME or zero or flags & (0xFF if found == SKIP_MAP else 0xFE):
        raise Unsupported
    assert found == kind
    assert layer < len(shape.slots)
    assert not (kind == SKIP_MAP and layer)
    return Head(layer, bool(flags & 1), birth)


class BitDecoder:
    def __init__(self, body: bytes) -> None:
        assert len(body) >= 4
        self.body = body
        self.at = 4
        self.range = 2**32 - 1
        self.code = int.from_bytes(body[:4], "big")
        assert self.code < self.range
        self.p = [32768] * 37
        self.c = [0] * 37

    def bit(self, context: int) -> int:
        p = self.p[context]
        bound = (self.range // 4096) * (p // 16)
        bit = int(self.code >= bound)
        if bit:
            self.code -= bound
            self.range -= bound
        else:
            self.range = bound
        while self.range < 2**24:
            assert self.at < len(self.body)
            self.range *= 256
            self.code = self.code * 256 + self.body[self.at]
            self.at += 1
        assert self.code < self.range < 2**32
        self.c[context] = min(self.c[context] + 1, 127)
        part = 2 ** math.floor(math.log2(self.c[context] + 1))
        self.p[context] = p - p // part if bit else p + (65535 - p) // part
        return bit


def decode_skip_map(body: bytes, slots: Sequence[int], before: Sequence[Statuses]) -> Statuses:
    """`before`: the relevant earlier skip maps of this lane, the last one first."""
    decoder = BitDecoder(body)
    skip_map = []
    for layer, count in enumerate(slots):
        statuses: list[int] = []
        for slot in range(count):
            near = [int(slot >= d and statuses[slot - d] != KEPT) for d in (1, 2, 3)]
            past = [int(len(before) > d and before[d][layer][slot] != KEPT) for d in (0, 1)]
            n, m, h = 2 * near[0] + near[1], near[2], 2 * past[0] + past[1]
            if decoder.bit(8 * h + 2 * n + m) == 0:
                statuses.append(KEPT)
            elif decoder.bit(32 + h) == 0:
                statuses.append(PREDICTED)
            else:
                statuses.append(NEW if decoder.bit(36) == 0 else ENDED)
        skip_map.append(statuses)
    assert decoder.at == len(body)
    return skip_map


# --- Section 10: change ---


class Cursor:
    def __init__(self, data: bytes) -> None:
        self.data = data
        self.at = 0

    def take(self, count: int) -> bytes:
        assert self.at + count <= len(self.data)
        self.at += count
        return self.data[self.at - count : self.at]

    def integers(self, count: int, kind: str = "I") -> tuple[int, ...]:
        return struct.unpack(f"<{count}{kind}", self.take(4 * count))

    def floats(self, count: int) -> tuple[float, ...]:
        return struct.unpack(f"<{count}f", self.take(4 * count))


@dataclass(frozen=True, slots=True)
class Residual:
    position: tuple[int, ...]
    attributes: tuple[int, ...]


@dataclass(frozen=True, slots=True)
class Change:
    """A decoded change; starts of the new Gaussians are relative to the birth."""

    predicted: list[Residual]
    new: list[Gaussian]


def unzigzag(z: int) -> int:
    return -(z + 1) // 2 if z % 2 else z // 2


def rows(values: tuple[float, ...], width: int) -> list[tuple[float, ...]]:
    return [values[i : i + width] for i in range(0, len(values), width)]


def columns(data: bytes, count: int, num_planes: int) -> list[tuple[int, ...]]:
    """The bytes of each Gaussian, from one plane after another."""
    return [tuple(data[p * count + i] for p in range(num_planes)) for i in range(count)]


def decode_change(
    body: bytes, shape: Shape, layer: int, counts: tuple[int, int], has_starts: bool
) -> Change:
    """`counts`: numbers of predicted and of new slots in the layer."""
    cursor = Cursor(body)
    k = shape.num_coefficients
    predicted, new, long, escapes, low_bit_bytes = cursor.integers(5)
    assert (predicted, new) == counts
    assert long <= 3 * predicted
    assert escapes <= new
    residual_bytes = cursor.take((10 + 3 * k) * predicted)
    long_residuals = cursor.integers(long, "i")
    residuals = decode_residuals(residual_bytes, predicted, long_residuals, k)
    new_bytes = cursor.take((10 + 3 * k) * new)
    low_bits = cursor.take(low_bit_bytes)
    gaussians = decode_new(new_bytes, new, low_bits, k, shape.lattice[layer])
    which = cursor.integers(escapes)
    assert all(earlier < later for earlier, later in pairwise(which))
    assert all(i < new for i in which)
    exact = decode_escapes(cursor.take(4 * (11 + 3 * k) * escapes), escapes, k)
    for i, values in zip(which, exact, strict=True):
        gaussians[i] = replace(gaussians[i], escaped=values)
    starts = cursor.take(new) if has_starts else bytes(new)
    assert cursor.at == len(body)
    assert all(start < shape.swin_size for start in starts)
    return Change(residuals, [replace(g, start=s) for g, s in zip(gaussians, starts, strict=True)])


def decode_residuals(
    data: bytes, count: int, long_residuals: tuple[int, ...], k: int
) -> list[Residual]:
    places = data[: 3 * count]
    assert places.count(255) == len(long_residuals)
    rest = iter(long_residuals)
    moves = [next(rest) if z == 255 else unzigzag(z) for z in places]
    attributes = columns(data[3 * count :], count, 7 + 3 * k)
    return [
        Residual(
            (moves[i], moves[count + i], moves[2 * count + i]), tuple(map(unzigzag, attributes[i]))
        )
        for i in range(count)
    ]


def decode_new(
    data: bytes, count: int, low_bits: bytes, k: int, lattice: Lattice
) -> list[Gaussian]:
    bits = int.from_bytes(low_bits, "little")
    used = 0
    position = [0, 0, 0]
    gaussians = []
    for row in columns(data, count, 10 + 3 * k):
        for axis, length in enumerate(row[:3]):
            assert length <= 25
            if length:
                width = length - 1
                position[axis] += unzigzag((1 << width) | (bits >> used) & ((1 << width) - 1))
                used += width
        assert in_lattice(position)
        assert row[-1] < lattice.opacity_levels
        attributes = (*(byte - 128 for byte in row[3:-1]), row[-1])
        gaussians.append(Gaussian(0, tuple(position), attributes))
    assert (used + 7) // 8 == len(low_bits)
    assert bits >> used == 0
    return gaussians


def decode_escapes(data: bytes, count: int, k: int) -> list[Floats]:
    cursor = Cursor(data)
    means, scales, quats, logits, sh = (
        rows(cursor.floats(width * count), width) for width in (3, 3, 4, 1, 3 * k)
    )
    assert all(map(math.isfinite, chain(*means, *scales, *quats, *logits, *sh)))
    assert all(map(any, quats))
    return [
        Floats(mean, scale, quat, opacity, tuple(rows(colours, 3)))
        for mean, scale, quat, (opacity,), colours in zip(
            means, scales, quats, logits, sh, strict=True
        )
    ]


def predict(before: Slot, residual: Residual, birth: int, lattice: Lattice) -> Slot:
    """State of a predicted slot after the change."""
    if before is Hole.UNKNOWN:
        return Hole.UNKNOWN
    assert isinstance(before, Gaussian)
    assert before.escaped is None
    position = tuple(a + b for a, b in zip(before.position, residual.position, strict=True))
    assert in_lattice(position)
    sums = [a + b for a, b in zip(before.attributes, residual.attributes, strict=True)]
    opacity = sums[-1] % 256
    assert opacity < lattice.opacity_levels
    signed = ((value + 128) % 256 - 128 for value in sums[:-1])
    return Gaussian(birth, position, (*signed, opacity))


# --- Section 11: keyframe ---


def decode_keyframe(chunk: bytes, shape: Shape) -> tuple[Head, list[list[Slot]]]:
    """The slots of each lane, in the order of births birth - swin_size + 1 .. birth."""
    head = decode_head(chunk, KEYFRAME, shape)
    count = shape.slots[head.layer]
    num_flags = shape.swin_size * count
    num_bytes = (num_flags + 7) // 8
    assert len(chunk) >= 12 + num_bytes
    flags = int.from_bytes(chunk[12 : 12 + num_bytes], "little")
    assert flags >> num_flags == 0
    counts = (0, flags.bit_count())
    change = decode_change(chunk[12 + num_bytes :], shape, head.layer, counts, head.has_starts)
    gaussians = iter(change.new)
    lanes = []
    for i in range(shape.swin_size):
        birth = head.birth - shape.swin_size + 1 + i
        lane: list[Slot] = []
        for slot in range(count):
            if flags >> (i * count + slot) & 1:
                gaussian = next(gaussians)
                lane.append(replace(gaussian, start=birth + gaussian.start))
            else:
                lane.append(Hole.EMPTY)
        lanes.append(lane)
    return head, lanes
