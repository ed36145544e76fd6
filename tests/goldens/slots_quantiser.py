"""Puts Gaussians on a lattice as section 14.1 allows: equal forms, clamped scales, held numbers."""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import product

from tests.goldens.slots_decoder import Floats, Gaussian, Lattice, in_lattice, to_floats

Quat = tuple[float, ...]
Form = tuple[Quat, tuple[float, ...]]
"""A unit quaternion with w not negative, and log-scales."""

HALF = math.sqrt(0.5)
MOST_HELD_STEPS = 4


def times(a: Quat, b: Quat) -> Quat:
    aw, ax, ay, az = a
    bw, bx, by, bz = b
    return (
        aw * bw - ax * bx - ay * by - az * bz,
        aw * bx + ax * bw + ay * bz - az * by,
        aw * by - ax * bz + ay * bw + az * bx,
        aw * bz + ax * by - ay * bx + az * bw,
    )


def dot(a: Sequence[float], b: Sequence[float]) -> float:
    return sum(x * y for x, y in zip(a, b, strict=True))


def turns() -> list[tuple[Quat, tuple[int, ...]]]:
    """The 24 turns that map axes to axes, and which axis comes where."""
    orders: list[tuple[Quat, tuple[int, ...]]] = [
        ((1.0, 0.0, 0.0, 0.0), (0, 1, 2)),
        ((HALF, HALF, 0.0, 0.0), (0, 2, 1)),
        ((HALF, 0.0, HALF, 0.0), (2, 1, 0)),
        ((HALF, 0.0, 0.0, HALF), (1, 0, 2)),
        ((0.5, 0.5, 0.5, 0.5), (1, 2, 0)),
        ((0.5, -0.5, -0.5, -0.5), (2, 0, 1)),
    ]
    halves = [tuple(float(i == j) for j in range(4)) for i in range(4)]
    return [(times(turn, half), axes) for (turn, axes), half in product(orders, halves)]


TURNS = turns()


def forms(floats: Floats) -> list[Form]:
    """All equal ones."""
    length = math.sqrt(dot(floats.quat, floats.quat))
    unit = tuple(q / length for q in floats.quat)
    found = []
    for turn, axes in TURNS:
        quat = times(unit, turn)
        sign = math.copysign(1, quat[0])
        scales = tuple(floats.log_scales[axis] for axis in axes)
        found.append((tuple(sign * q for q in quat), scales))
    return found


def chosen_form(floats: Floats, before: Floats | None) -> Form:
    """The nearest to the one before; of a new Gaussian that of the largest w."""
    near = (1.0, 0.0, 0.0, 0.0) if before is None else before.quat
    return max(forms(floats), key=lambda form: abs(dot(form[0], near)))


def levels_of(floats: Floats, form: Form, lattice: Lattice) -> list[float]:
    """What the integers of the state would be, were they real: position, then attributes."""
    quat, scales = form
    rest = [(r + b) / 4 + g / 2 for r, g, b in floats.sh]
    orange = [(r - b) / 2 for r, _, b in floats.sh]
    green = [g / 2 - (r + b) / 4 for r, g, b in floats.sh]
    opacity = 1 / (1 + math.exp(-floats.logit_opacity))
    return [
        *(x / lattice.position_m for x in floats.mean),
        *((s - lattice.log_scale_base) / lattice.log_scale for s in scales),
        *(r / lattice.rotation for r in quat[1:]),
        *(c / lattice.colour for c in (*rest, *orange, *green)),
        opacity * (lattice.opacity_levels - 1),
    ]


def quantised(
    floats: Floats, lattice: Lattice, before: Gaussian | None, birth: int, held_steps: float = 0
) -> Gaussian | None:
    """A new Gaussian, or one predicted from `before`; none if the lattice cannot hold it."""
    assert 0 <= held_steps <= MOST_HELD_STEPS
    form = chosen_form(floats, None if before is None else to_floats(before, lattice))
    levels = levels_of(floats, form, lattice)
    levels[3:6] = (max(level, -128.0) for level in levels[3:6])  # flat axes
    state = list(map(round, levels))
    if before is not None:
        old = (*before.position, *before.attributes)
        state = [
            o if abs(level - o) <= held_steps else n
            for n, o, level in zip(state, old, levels, strict=True)
        ]
    position, attributes = tuple(state[:3]), tuple(state[3:])
    if not in_lattice(position) or not all(-128 <= a <= 127 for a in attributes[:-1]):
        return None
    return Gaussian(birth, position, attributes)
