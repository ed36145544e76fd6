"""Profile `compact`: the body of a chunk is quantised, sorted and laid out as byte planes.

Rule: a Gaussian that the quantisers cannot hold (a far outlier, an enormous scale) escapes: it is
stored as float32. So the error of every value is bounded, whatever the input.
"""

from __future__ import annotations

import struct
from collections.abc import Sequence
from dataclasses import astuple, dataclass, replace

import numpy as np
import numpy.typing as npt

from codec.errors import CorruptError
from codec.kernel import kernel
from codec.pose import Doubles
from codec.splats import SH_C0, Floats, Splats, sh_count

from . import quantise, raw
from .body import Body
from .morton import BITS_PER_AXIS, decode_gaps, encode_gaps, gather, interleave
from .orientation import canonical
from .quantise import (
    MAX_OPACITY_LEVELS,
    MAX_ROTATION_HALF,
    MIDDLE,
    Steps,
    choose_steps,
    from_luma,
    opacity_logits,
    to_luma,
)

CODE = 2

# origin x y z, position step, log-scale base and step, rotation step, colour base and step;
# opacity levels, rotation half, escapes, bytes of low bits
HEAD = struct.Struct("<9fHHII")
assert HEAD.size == 48

GEOMETRY_PLANES = 8
"""Planes of gap lengths, three scales, three of rotation, opacity. Those of colour come behind."""

TAME = 1e30
"""Magnitude from which a value escapes, so that no dequantised one overflows float32."""

LARGEST_TURN = 0.5**0.5
"""Magnitude that x, y and z of a unit quaternion reach where w is the largest component."""

MAX_ESCAPE_SHARE = 0.005
MIN_ESCAPES = 4
"""A step grows until the integers reach all values but this share, or all but this many."""

Flags = npt.NDArray[np.bool_]


@dataclass(frozen=True, slots=True)
class Quantised:
    """N Gaussians as integers, clipped for those that do not fit: they must escape."""

    planes: npt.NDArray[np.int64]  # (P, N)
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

    def floats(self) -> Floats:
        """(9,) float32: all but the last four."""
        return np.array(astuple(self)[:9], np.float32)

    def pack(self) -> bytes:
        return HEAD.pack(*astuple(self))

    @staticmethod
    def unpack(body: memoryview) -> Head:
        if len(body) < HEAD.size:
            raise CorruptError(f"compact: {len(body)} bytes are too few for a head of {HEAD.size}")
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
    """`value` rounded to float32, for the encoder must calculate with what the decoder reads."""
    return float(np.float32(np.clip(value, -TAME, TAME)))


def _spare(count: int) -> int:
    """How many of `count` values may escape from one range before its step grows."""
    return min(count - 1, max(int(MAX_ESCAPE_SHARE * count), MIN_ESCAPES))


def _fit(values: Doubles, step: float, levels: int) -> tuple[float, float]:
    """The start of a range of `levels` steps that holds `values`, and the step, grown if need be.

    A few values may lie outside the range, see `_spare`; they escape.
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
    """`step`, or a larger one if the coefficients that lie around zero need it."""
    if not len(sh):
        return step
    # All but the luma of the first coefficient, which has a base of its own.
    farthest = np.zeros(len(sh))
    for column in sh.reshape(len(sh), 3 * sh.shape[1]).T[1:]:
        np.maximum(farthest, np.abs(column), out=farthest)
    spare = _spare(len(sh))
    return max(step, float(np.partition(farthest, -1 - spare)[-1 - spare]) / (MIDDLE - 1))


def _is_tame(splats: Splats) -> Flags:
    """(N,) whether every number of a Gaussian is of a sane magnitude."""
    tame = np.ones(len(splats), bool)
    sh = splats.sh.reshape(len(splats), 3 * splats.sh.shape[1])
    for array in (splats.means, splats.log_scales, sh):
        # Column by column: reducing short rows costs several times as much.
        for column in array.T:
            tame &= np.abs(column) < TAME
    return tame


def _choose_head(means: Doubles, scales: Doubles, sh: Doubles, steps: Steps) -> Head:
    reach = (1 << BITS_PER_AXIS) - 2
    step_m = _single(max(_fit(axis, steps.position_m, reach)[1] for axis in means.T))
    x, y, z = (_single(_fit(axis, step_m, reach)[0]) for axis in means.T)
    scale_base, scale_step = _fit(scales[:, 0], steps.log_scale, 254)
    colour_base, colour_step = _fit(sh[:, 0, 0], _colour_step(sh, steps.colour), 254)
    half = int(np.clip(np.rint(LARGEST_TURN / steps.rotation), 1, MAX_ROTATION_HALF))
    return Head(
        x,
        y,
        z,
        step_m,
        _single(scale_base),
        _single(scale_step),
        _single(LARGEST_TURN / half),
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
    fits = np.ones(len(splats), bool)
    for axis in places.T:
        fits &= (axis >= 0) & (axis < 1 << BITS_PER_AXIS)
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


def encode(splats: Splats, steps: Steps | None) -> Body:
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
    tail = raw.pack_arrays(splats.take(escaped))
    data = head.pack() + planes.tobytes() + low_bits + tail
    order = np.concatenate([inside, escaped])
    return Body(data, _edges(head, len(splats), splats.sh_degree, len(data)), order)


def decode(body: memoryview, count: int, sh_degree: int) -> Splats:
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
    means, log_scales, quats, opacities, sh = (
        np.empty((count, *array.shape[1:]), np.float32) for array in escaped
    )
    arrays = means, log_scales, quats, opacities, sh
    logits = opacity_logits(head.opacity_levels)
    # With NUMBA_DISABLE_JIT the kernel is numpy, which warns of an overflow. Splats refuses the
    # result, which is not finite.
    with np.errstate(over="ignore", invalid="ignore"):
        _dequantise(codes, planes, head.floats(), head.rotation_half, logits, *arrays)
    for array, part in zip(arrays, escaped, strict=True):
        array[inside:] = part
    return Splats(*arrays)


@kernel(nogil=True, error_model="numpy")
def _dequantise(  # type: ignore[no-untyped-def]
    codes, planes, floats, half, logits, means, log_scales, quats, logit_opacities, sh
):
    """Fills as many rows as there are codes. Without fastmath: FORMAT.md says the order of every
    operation. floats: `Head.floats`."""
    position_step_m, scale_base, scale_step = floats[3], floats[4], floats[5]
    rotation_step, colour_base, colour_step = floats[6], floats[7], floats[8]
    one, zero = np.float32(1), np.float32(0)
    coefficients = sh.shape[1]
    for i in range(codes.shape[0]):
        for axis in range(3):
            place = np.float32(gather(codes[i] >> np.uint64(axis)))
            means[i, axis] = place * position_step_m + floats[axis]
        size = np.int32(planes[1, i])
        for axis in range(3):
            if axis:
                size -= np.int32(planes[1 + axis, i])
            log_scales[i, axis] = np.float32(size) * scale_step + scale_base
        x = np.float32(np.int32(planes[4, i]) - half) * rotation_step
        y = np.float32(np.int32(planes[5, i]) - half) * rotation_step
        z = np.float32(np.int32(planes[6, i]) - half) * rotation_step
        quats[i, 0] = np.sqrt(max(one - ((x * x + y * y) + z * z), zero))
        quats[i, 1], quats[i, 2], quats[i, 3] = x, y, z
        logit_opacities[i] = logits[planes[7, i]]
        for k in range(coefficients):
            luma = np.int32(planes[GEOMETRY_PLANES + k, i])
            if k:
                luma_value = np.float32(luma - MIDDLE) * colour_step
            else:
                luma_value = np.float32(luma) * colour_step + colour_base
            co = np.int32(planes[GEOMETRY_PLANES + coefficients + k, i]) - MIDDLE
            cg = np.int32(planes[GEOMETRY_PLANES + 2 * coefficients + k, i]) - MIDDLE
            sh[i, k, 0], sh[i, k, 1], sh[i, k, 2] = from_luma(
                luma_value, np.float32(co) * colour_step, np.float32(cg) * colour_step
            )


def edges(body: memoryview, count: int, sh_degree: int) -> list[int]:
    return _edges(Head.unpack(body), count, sh_degree, len(body))


def _edges(head: Head, count: int, sh_degree: int, body_bytes: int) -> list[int]:
    """Offsets in a body between its head, its planes, the low bits and the escapes."""
    inside = count - head.escapes
    planes = [HEAD.size + plane * inside for plane in range(num_planes(sh_degree) + 1)]
    return [0, *planes, planes[-1] + head.low_bit_bytes, body_bytes]


def layer_steps(layers: Sequence[Splats]) -> Sequence[Steps | None]:
    return quantise.layer_steps(layers)
