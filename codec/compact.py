"""Profile `compact`: the body of a chunk is quantised, sorted and laid out as byte planes.

Rule: what fits no quantiser (a far outlier, an enormous scale) escapes and is stored as float32, so
the error of every stored value is bounded whatever the input.
"""

from __future__ import annotations

import struct
from dataclasses import astuple, dataclass, replace

import numpy as np
import numpy.typing as npt

from . import raw
from .errors import CorruptError
from .morton import BITS_PER_AXIS, Codes, decode_gaps, deinterleave, encode_gaps, interleave
from .orientation import canonical
from .quantize import (
    MAX_OPACITY_LEVELS,
    MAX_ROTATION_HALF,
    MIDDLE,
    Bytes,
    Doubles,
    Steps,
    choose_steps,
    from_luma,
    opacity_logits,
    to_luma,
)
from .splats import SH_C0, Floats, Splats, sh_count

# origin x y z, position step, log-scale base and step, rotation step, colour base and step;
# opacity levels, rotation half, escapes, bytes of low bits
HEAD = struct.Struct("<9fHHII")
assert HEAD.size == 48

GEOMETRY_PLANES = 8
"""Gap lengths, three scales, three of rotation, opacity; then three for each SH coefficient."""

TAME = 1e30
"""Magnitude from which a value escapes, so that no dequantised one overflows float32."""

BLOCK = 1 << 14
"""Gaussians dequantised at a time: what lies between bytes and value then fits a cache."""

MAX_ESCAPE_SHARE = 0.005
MIN_ESCAPES = 4
"""A step grows until at most this share, or this many, lie outside what the integers reach."""

Flags = npt.NDArray[np.bool_]


@dataclass(frozen=True, slots=True)
class Quantised:
    """The integers of N Gaussians and which of them say the truth."""

    planes: npt.NDArray[np.int64]  # (P, N); right where `fits`
    positions: npt.NDArray[np.int64]  # (N, 3)
    fits: Flags  # (N,)


@dataclass(frozen=True, slots=True)
class Head:
    """The numbers in front of the planes, in the order of the file, as float32 holds them."""

    origin_x_m: float
    origin_y_m: float
    origin_z_m: float
    position_step_m: float
    scale_base: float
    scale_step: float
    rotation_step: float
    colour_base: float
    colour_step: float
    opacity_levels: int
    rotation_half: int
    escapes: int = 0
    low_bit_bytes: int = 0

    @property
    def origin_m(self) -> tuple[float, float, float]:
        return self.origin_x_m, self.origin_y_m, self.origin_z_m

    def pack(self) -> bytes:
        return HEAD.pack(*astuple(self))

    @staticmethod
    def unpack(body: memoryview) -> Head:
        if len(body) < HEAD.size:
            raise CorruptError(f"compact: {len(body)} bytes are no head of {HEAD.size}")
        head = Head(*HEAD.unpack_from(body))
        if not np.isfinite(astuple(head)).all():
            raise CorruptError("compact: a number in the head is not finite")
        if not 2 <= head.opacity_levels <= MAX_OPACITY_LEVELS:
            raise CorruptError(f"compact: {head.opacity_levels} opacity levels")
        if not 1 <= head.rotation_half <= MAX_ROTATION_HALF:
            raise CorruptError(f"compact: rotation half {head.rotation_half}")
        return head


def num_planes(sh_degree: int) -> int:
    """Byte planes in a body."""
    return GEOMETRY_PLANES + 3 * sh_count(sh_degree)


def _single(value: float) -> float:
    """`value` as float32 holds it: the encoder must reckon with what the decoder will read."""
    return float(np.float32(np.clip(value, -TAME, TAME)))


def _spare(count: int) -> int:
    """How many of `count` values may escape from one range before its step grows."""
    return min(count - 1, max(int(MAX_ESCAPE_SHARE * count), MIN_ESCAPES))


def _fit(values: Doubles, step: float, levels: int) -> tuple[float, float]:
    """Where a range of `levels` steps starts that holds `values`, and a step, grown if it must.

    What lies outside the range escapes, which is little: see `_spare`.
    """
    if not len(values):
        return 0.0, step
    low = float(values.min())
    if values.max() - low <= levels * step:
        return low, step
    ordered = np.sort(values)
    spare = _spare(len(ordered))
    widths = ordered[len(ordered) - 1 - spare :] - ordered[: spare + 1]
    first = int(np.argmin(widths))
    step = max(step, float(widths[first]) / levels)
    middle = ordered[first] + widths[first] / 2
    return float(middle) - levels * step / 2, step


def _colour_step(sh: Doubles, step: float) -> float:
    """`step`, or as much more as the coefficients that lie around zero need."""
    if not len(sh):
        return step
    # All but the luma of the first one, which has a base of its own.
    around_zero = np.concatenate([sh[:, 0, 1:], *sh[:, 1:].transpose(1, 0, 2)], axis=1)
    farthest = np.abs(around_zero).max(axis=1)
    spare = _spare(len(sh))
    return max(step, float(np.partition(farthest, -1 - spare)[-1 - spare]) / (MIDDLE - 1))


def _is_tame(splats: Splats) -> Flags:
    """(N,) whether every number of a Gaussian is of a sane magnitude."""
    rows = (splats.means, splats.log_scales, *splats.sh.transpose(1, 0, 2))
    tame: Flags = (np.abs(np.concatenate(rows, axis=1)) < TAME).all(axis=1)
    return tame


def _choose_head(means: Doubles, scales: Doubles, sh: Doubles, steps: Steps) -> Head:
    reach = (1 << BITS_PER_AXIS) - 2
    step_m = _single(max(_fit(axis, steps.position_m, reach)[1] for axis in means.T))
    x, y, z = (_single(_fit(axis, step_m, reach)[0]) for axis in means.T)
    scale_base, scale_step = _fit(scales[:, 0], steps.log_scale, 254)
    colour_base, colour_step = _fit(sh[:, 0, 0], _colour_step(sh, steps.colour), 254)
    half = int(np.clip(np.rint(0.5**0.5 / steps.rotation), 1, MAX_ROTATION_HALF))
    return Head(
        x,
        y,
        z,
        step_m,
        _single(scale_base),
        _single(scale_step),
        _single(0.5**0.5 / half),
        _single(colour_base),
        _single(colour_step),
        int(np.clip(np.rint(1 / steps.opacity) + 1, 2, MAX_OPACITY_LEVELS)),
        half,
    )


def _quantise(splats: Splats, steps: Steps) -> tuple[Head, Quantised]:
    means = splats.means.astype(np.float64)
    scales, quats = canonical(splats.log_scales, splats.quats)
    rgb = splats.sh.astype(np.float64)
    if splats.sh_degree == 0:
        # Colour below black is drawn black; without view dependence nothing is lost by saying so.
        rgb = np.maximum(rgb, -0.5 / SH_C0)
    sh = to_luma(rgb)
    head = _choose_head(means, scales, sh, steps)

    places = np.rint((means - head.origin_m) / head.position_step_m)
    fits = np.asarray(((places >= 0) & (places < 1 << BITS_PER_AXIS)).all(axis=1))
    sizes = np.rint((scales - head.scale_base) / head.scale_step)
    turns = np.rint(quats[:, 1:] / head.rotation_step) + head.rotation_half
    colours = np.rint(sh / head.colour_step) + MIDDLE
    colours[:, 0, 0] = np.rint((sh[:, 0, 0] - head.colour_base) / head.colour_step)
    opacities = np.rint(splats.opacities.astype(np.float64) * (head.opacity_levels - 1))
    planes = np.concatenate(
        [
            np.zeros((1, len(splats))),  # gap lengths, known only once sorted
            sizes[:, :1].T,
            (sizes[:, :1] - sizes[:, 1:2]).T,
            (sizes[:, 1:2] - sizes[:, 2:]).T,
            turns.T,
            opacities[None],
            np.concatenate(list(colours.transpose(2, 1, 0))),
        ]
    )
    fits &= ((planes >= 0) & (planes <= 255)).all(axis=0)
    clipped = np.clip(planes, 0, 255).astype(np.int64)
    reachable = np.clip(places, 0, (1 << BITS_PER_AXIS) - 1).astype(np.int64)
    return head, Quantised(clipped, reachable, fits)


def encode_body(splats: Splats, steps: Steps | None = None) -> tuple[bytes, npt.NDArray[np.int64]]:
    """The body, and the (N,) order in which it holds the Gaussians."""
    tame = np.flatnonzero(_is_tame(splats))
    head, quantised = _quantise(splats.take(tame), choose_steps(splats) if steps is None else steps)
    fitting = np.flatnonzero(quantised.fits)
    codes = interleave(quantised.positions[fitting])
    by_code = np.argsort(codes, kind="stable")
    fitting = fitting[by_code]
    lengths, low_bits = encode_gaps(codes[by_code])
    planes = quantised.planes[:, fitting].astype(np.uint8)
    planes[0] = lengths
    inside = tame[fitting]
    escaped = np.setdiff1d(np.arange(len(splats)), inside, assume_unique=True)
    head = replace(head, escapes=len(escaped), low_bit_bytes=len(low_bits))
    tail = raw.encode_body(splats.take(escaped))
    return head.pack() + planes.tobytes() + low_bits + tail, np.concatenate([inside, escaped])


def decode_body(body: memoryview, count: int, sh_degree: int) -> Splats:
    """The Splats in `body`. Raises CorruptError (format) or InvalidError (values)."""
    head = Head.unpack(body)
    if head.escapes > count:
        raise CorruptError(f"compact: {head.escapes} escapes among {count} Gaussians")
    inside = count - head.escapes
    planes_end = HEAD.size + num_planes(sh_degree) * inside
    low_bits_end = planes_end + head.low_bit_bytes
    if len(body) < low_bits_end:
        raise CorruptError(f"compact: a body of {len(body)} bytes for {count} Gaussians")
    planes = np.frombuffer(body[HEAD.size : planes_end], np.uint8)
    planes = planes.reshape(num_planes(sh_degree), inside)
    if inside and planes[7].max() >= head.opacity_levels:
        raise CorruptError(f"compact: opacity {planes[7].max()} of {head.opacity_levels} levels")
    escaped = raw.read_arrays(body[low_bits_end:], head.escapes, sh_degree)
    codes = decode_gaps(planes[0], body[planes_end:low_bits_end])
    # Filled piece by piece: whatever a chunk claims, it costs its bytes and its value, no more.
    arrays = tuple(np.empty((count, *array.shape[1:]), np.float32) for array in escaped)
    with np.errstate(all="ignore"):
        for start in range(0, inside, BLOCK):
            rows = slice(start, min(start + BLOCK, inside))
            for array, part in zip(
                arrays, _dequantise(head, codes[rows], planes[:, rows]), strict=True
            ):
                array[rows] = part
    for array, part in zip(arrays, escaped, strict=True):
        array[inside:] = part
    means, log_scales, quats, opacities, sh = arrays
    return Splats(means, log_scales, quats, opacities, sh)


def _dequantise(head: Head, codes: Codes, planes: Bytes) -> tuple[Floats, ...]:
    """means, log_scales, quats, logit_opacities and sh of some of the Gaussians."""
    f32 = np.float32
    places = deinterleave(codes).astype(f32)
    means = places * f32(head.position_step_m) + np.array(head.origin_m, f32)

    largest = planes[1].astype(np.int32)
    middle = largest - planes[2]
    sizes = np.stack([largest, middle, middle - planes[3]], axis=1).astype(f32)
    log_scales = sizes * f32(head.scale_step) + f32(head.scale_base)

    turns = planes[4:7].astype(np.int32) - head.rotation_half
    x, y, z = turns.astype(f32) * f32(head.rotation_step)
    w = np.sqrt(np.maximum(f32(1) - ((x * x + y * y) + z * z), f32(0)))

    colours = np.stack(np.split(planes[GEOMETRY_PLANES:], 3))
    sh = (colours.astype(np.int32) - MIDDLE).astype(f32) * f32(head.colour_step)
    sh[0, 0] = colours[0, 0].astype(f32) * f32(head.colour_step) + f32(head.colour_base)
    rgb = from_luma(sh[0], sh[1], sh[2])
    return (
        means,
        log_scales,
        np.stack([w, x, y, z], axis=1),
        opacity_logits(head.opacity_levels)[planes[7]],
        rgb.transpose(1, 0, 2),
    )


def plane_edges(body: memoryview, count: int, sh_degree: int) -> list[int]:
    """Offsets in `body` between its head, its planes, the low bits and the escapes."""
    head = Head.unpack(body)
    inside = count - head.escapes
    edges = [HEAD.size + plane * inside for plane in range(num_planes(sh_degree) + 1)]
    return [0, *edges, edges[-1] + head.low_bit_bytes, len(body)]
