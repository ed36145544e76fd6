"""Rotation and scales of a Gaussian, brought to the one of 24 equal forms that costs least to code.

A Gaussian stays the same when its axes are permuted together with its scales (6 ways) or turned
by 180 degrees (4 ways). The canonical form has falling scales and the largest quaternion component
in w: no permutation, no index of the largest component, 4.6 bits less a Gaussian.
"""

from __future__ import annotations

import numpy as np

from codec.arrays import Doubles, Floats
from codec.kernel import kernel

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
