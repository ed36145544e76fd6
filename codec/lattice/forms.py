"""How large the steps of a lattice are, and the forms in which Gaussians cost least on it: colours
as luma, one of 24 equal forms of rotation and scales, positions along the Morton curve.

A Gaussian stays the same when its axes are permuted together with its scales (6 ways) or turned by
180 degrees (4 ways). The canonical form has falling scales and the largest quaternion component in
w: no permutation, no index of the largest component, 4.6 bits less a Gaussian.

Rule: the way back to floats does the operations that FORMAT.md states, in its order and precision.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from codec.arrays import Doubles, Floats, Longs
from codec.kernel import kernel
from codec.splats import Splats

MAX_OPACITY_LEVELS = 256
MAX_LOGIT = 16.0

# Found on trained models by rendering: each bit then buys about the same in every attribute, and
# the picture loses about 0.05 dB, measured in bench/NOTEBOOK.md.
POSITION_PER_SIZE = 1 / 11
BASE_LOG_SCALE = 0.125
BASE_ROTATION = 1 / 60
BASE_COLOUR = 0.056

MIN_COARSENESS, MAX_COARSENESS = 0.5, 4.0
"""How far the steps of a layer may lie from those of its slice."""


def _log_paint(splats: Splats) -> Doubles:
    """(N,) log of opacity times the radius of the widest section: how much an error shows."""
    log_opacity = -np.logaddexp(0.0, -splats.logit_opacities.astype(np.float64))
    return log_opacity + _log_radius(splats)


def _log_radius(splats: Splats) -> Doubles:
    """(N,) log of the geometric mean of the two larger standard deviations."""
    # Column by column: reducing rows of three costs several times as much.
    x, y, z = splats.log_scales.T.astype(np.float64)
    radius: Doubles = (x + y + z - np.minimum(np.minimum(x, y), z)) / 2
    return radius


def position_step_m(splats: Splats) -> float:
    """The step of positions that suits `splats`: it follows their sizes, for a scene may have any
    scale."""
    if len(splats):
        weights = splats.opacities.astype(np.float64) + 1e-6
        log_size = (weights * _log_radius(splats)).sum() / weights.sum()
    else:
        log_size = 0.0
    # At least 1e-6 m, so that hostile or broken input never divides by zero.
    return max(POSITION_PER_SIZE * float(np.exp(np.clip(log_size, -30, 30))), 1e-6)


def layer_coarseness(layers: Sequence[Splats]) -> list[float]:
    """Factors of the steps for each layer of one slice: the less its Gaussians paint, the coarser.

    Each layer then adds about the same error to the picture, which saves 5 % of the bytes at equal
    quality.
    """
    paint = [np.exp(np.clip(_log_paint(layer), -60, 60)) for layer in layers]
    mean = np.concatenate(paint).mean() if any(map(len, paint)) else 1.0
    factors = [np.sqrt(mean / values.mean()) if len(values) else 1.0 for values in paint]
    return [float(np.clip(factor, MIN_COARSENESS, MAX_COARSENESS)) for factor in factors]


def to_luma(rgb: Doubles) -> Doubles:
    """(..., 3) Y, Co, Cg of (..., 3) RGB coefficients."""
    red, green, blue = rgb[..., 0], rgb[..., 1], rgb[..., 2]
    luma = (red + 2 * green + blue) / 4
    return np.stack([luma, (red - blue) / 2, (2 * green - red - blue) / 4], axis=-1)


@kernel(nogil=True)
def from_luma(y, co, cg):  # type: ignore[no-untyped-def]
    """Red, green, blue, all float32: G = Y + Cg, t = Y - Cg, R = t + Co, B = t - Co."""
    rest = y - cg
    return rest + co, y + cg, rest - co


def opacity_logits(levels: int) -> Floats:
    """(levels,) the logit of each opacity q / (levels - 1), rounded once to float32.

    Opacities 0 and 1 have no logit; MAX_LOGIT stands for them, which draws the same.
    """
    numbers = np.arange(1, levels - 1, dtype=np.float64)
    logits = np.full(levels, -MAX_LOGIT, np.float32)
    logits[1:-1] = np.log(numbers / (levels - 1 - numbers))
    logits[-1] = MAX_LOGIT
    return logits


_H = 0.5
_R = 0.5**0.5

# Quaternion (wxyz) of the rotation whose columns are the unit vectors e_a, e_b, +-e_c; at 3 a + b.
_PERMUTATIONS = np.zeros((9, 4))
_PERMUTATIONS[[1, 5, 6, 3, 2, 7]] = (
    (1, 0, 0, 0),  # 0 1 2
    (_H, _H, _H, _H),  # 1 2 0
    (_H, -_H, -_H, -_H),  # 2 0 1
    (0, _R, _R, 0),  # 1 0 2
    (_R, _R, 0, 0),  # 0 2 1
    (_R, 0, -_R, 0),  # 2 1 0
)


_ORDERS = np.array([(0, 1, 2), (1, 2, 0), (2, 0, 1), (1, 0, 2), (0, 2, 1), (2, 1, 0)])
"""The axes in the order of each of the six permutations."""

LEAST_W = 0.3
"""Smallest w of a form that is chosen for its nearness: below, w depends too much on the rounding
of x, y and z."""


@kernel(nogil=True)
def multiply(a, b):  # type: ignore[no-untyped-def]
    """The quaternion product a b of four numbers each, wxyz."""
    return (
        a[0] * b[0] - a[1] * b[1] - a[2] * b[2] - a[3] * b[3],
        a[0] * b[1] + a[1] * b[0] + a[2] * b[3] - a[3] * b[2],
        a[0] * b[2] - a[1] * b[3] + a[2] * b[0] + a[3] * b[1],
        a[0] * b[3] + a[1] * b[2] - a[2] * b[1] + a[3] * b[0],
    )


@kernel(nogil=True, error_model="numpy")
def _unit(quats, i):  # type: ignore[no-untyped-def]
    """Row i, of length 1. Over the largest component first, because the square of a tiny or a huge
    one is 0 or infinite."""
    w, x = np.float64(quats[i, 0]), np.float64(quats[i, 1])
    y, z = np.float64(quats[i, 2]), np.float64(quats[i, 3])
    largest = max(max(abs(w), abs(x)), max(abs(y), abs(z)))
    w, x, y, z = w / largest, x / largest, y / largest, z / largest
    norm = np.sqrt(w * w + x * x + y * y + z * z)
    return w / norm, x / norm, y / norm, z / norm


@kernel(nogil=True, error_model="numpy")
def _canonical(log_scales, quats, permutations, scales, chosen):  # type: ignore[no-untyped-def]
    for i in range(quats.shape[0]):
        first, second, third = 0, 1, 2
        if log_scales[i, second] > log_scales[i, first]:
            first, second = second, first
        if log_scales[i, third] > log_scales[i, second]:
            second, third = third, second
            if log_scales[i, second] > log_scales[i, first]:
                first, second = second, first
        scales[i, 0] = log_scales[i, first]
        scales[i, 1] = log_scales[i, second]
        scales[i, 2] = log_scales[i, third]

        w, x, y, z = multiply(_unit(quats, i), permutations[3 * first + second])
        # Times 1, i, j, k: half turns about the three axes, one of which moves the largest to w.
        a, b, c, d = abs(w), abs(x), abs(y), abs(z)
        if b > a and b >= c and b >= d:
            w, x, y, z = -x, w, z, -y
        elif c > a and c > b and c >= d:
            w, x, y, z = -y, -z, w, x
        elif d > a and d > b and d > c:
            w, x, y, z = -z, y, -x, w
        sign = -1.0 if w < 0 else 1.0
        chosen[i, 0], chosen[i, 1] = sign * w, sign * x
        chosen[i, 2], chosen[i, 3] = sign * y, sign * z


def canonical(log_scales: Floats, quats: Floats) -> tuple[Doubles, Doubles]:
    """The same Gaussians with (N, 3) falling log-scales and (N, 4) unit quaternions, w largest."""
    scales, chosen = np.empty(log_scales.shape), np.empty(quats.shape)
    _canonical(log_scales, quats, _PERMUTATIONS, scales, chosen)
    return scales, chosen


@kernel(nogil=True, error_model="numpy")
def _nearest_form(  # type: ignore[no-untyped-def]
    log_scales, quats, permutations, orders, wanted_scales, wanted_turns, scales, chosen
):
    """scales and chosen hold the canonical forms already; replaces those that lie farther away."""
    least_w = LEAST_W
    for i in range(quats.shape[0]):
        unit = _unit(quats, i)
        nearest = 0.0
        for axis in range(3):
            nearest += (scales[i, axis] - wanted_scales[i, axis]) ** 2
            nearest += (chosen[i, 1 + axis] - wanted_turns[i, axis]) ** 2
        for order in range(6):
            first, second, third = orders[order, 0], orders[order, 1], orders[order, 2]
            apart = (log_scales[i, first] - wanted_scales[i, 0]) ** 2
            apart += (log_scales[i, second] - wanted_scales[i, 1]) ** 2
            apart += (log_scales[i, third] - wanted_scales[i, 2]) ** 2
            if apart >= nearest:
                continue
            w, x, y, z = multiply(unit, permutations[3 * first + second])
            for turn in range(4):
                if turn == 1:
                    w, x, y, z = -x, w, z, -y
                elif turn == 2:  # after a half turn about x: one about z makes it one about y
                    w, x, y, z = -z, y, -x, w
                elif turn == 3:
                    w, x, y, z = -x, w, z, -y
                sign = -1.0 if w < 0 else 1.0
                if sign * w < least_w:
                    continue
                distance = apart + (sign * x - wanted_turns[i, 0]) ** 2
                distance += (sign * y - wanted_turns[i, 1]) ** 2
                distance += (sign * z - wanted_turns[i, 2]) ** 2
                if distance < nearest:
                    nearest = distance
                    scales[i, 0] = log_scales[i, first]
                    scales[i, 1] = log_scales[i, second]
                    scales[i, 2] = log_scales[i, third]
                    chosen[i, 0], chosen[i, 1] = sign * w, sign * x
                    chosen[i, 2], chosen[i, 3] = sign * y, sign * z


def nearest_form(
    log_scales: Floats, quats: Floats, wanted_scales: Doubles, wanted_turns: Doubles
) -> tuple[Doubles, Doubles]:
    """The same Gaussians in the form nearest to (N, 3) log-scales and (N, 3) x, y, z that are
    wanted, as `canonical` gives them: a small change of a Gaussian stays small."""
    scales, chosen = canonical(log_scales, quats)
    _nearest_form(
        log_scales, quats, _PERMUTATIONS, _ORDERS, wanted_scales, wanted_turns, scales, chosen
    )
    return scales, chosen


BITS_PER_AXIS = 20
"""Bits of an integer coordinate."""

Codes = npt.NDArray[np.uint64]


@kernel(nogil=True)
def _spread(value):  # type: ignore[no-untyped-def]
    """Bit b of a value below 2**BITS_PER_AXIS moved to bit 3 b."""
    # Each step doubles the distance between groups of bits: 16 + 4, then 8, 4, 2, 1.
    value = (value | (value << np.uint64(32))) & np.uint64(0x000F00000000FFFF)
    value = (value | (value << np.uint64(16))) & np.uint64(0x000F0000FF0000FF)
    value = (value | (value << np.uint64(8))) & np.uint64(0xF00F00F00F00F00F)
    value = (value | (value << np.uint64(4))) & np.uint64(0x30C30C30C30C30C3)
    return (value | (value << np.uint64(2))) & np.uint64(0x9249249249249249)


@kernel(nogil=True)
def _interleave(coordinates, codes):  # type: ignore[no-untyped-def]
    for i in range(codes.shape[0]):
        x = _spread(np.uint64(coordinates[i, 0]))
        y = _spread(np.uint64(coordinates[i, 1]))
        z = _spread(np.uint64(coordinates[i, 2]))
        codes[i] = x | (y << np.uint64(1)) | (z << np.uint64(2))


def interleave(coordinates: Longs) -> Codes:
    """(N,) Morton codes of (N, 3) coordinates below 2**BITS_PER_AXIS; bit 0 of x is the lowest."""
    codes = np.empty(len(coordinates), np.uint64)
    _interleave(coordinates, codes)
    return codes
