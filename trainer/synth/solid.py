"""The solids of the synthetic scene, and where rays hit them: spheres, round cones, boxes.

Directions are unit vectors, distances metres, and inf where nothing is hit.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from codec.kernel import kernel

Vector = tuple[float, float, float]
Table = npt.NDArray[np.float64]


class Parts(NamedTuple):
    """Round cones: each is the hull of two spheres, with a pattern and axes for it."""

    cones: Table  # (P, 12) metres: the two spheres and one around both, centre (3) and radius each
    axes: Table  # (P, 9) unit vectors right, up, forward of the pattern, in the world
    patterns: npt.NDArray[np.int64]  # (P,)
    colours: Table  # (P, 6) two linear RGB reflectances


FIRST, SECOND, AROUND = 0, 4, 8
"""Columns of `Parts.cones` where the centre of a sphere begins."""
RADIUS = 3
"""How many columns after that the sphere's radius stands."""

GROUP_FIRST, GROUP_END, GROUP_CENTRE, GROUP_RADIUS, GROUP_REACH = 0, 1, 2, 5, 6
"""Columns of a table of groups of parts: the first part and the one behind the last; centre (3) and
radius of a sphere around them; how far beyond it they darken the ambient light. Metres."""


class Boxes(NamedTuple):
    """Boxes turned about the vertical."""

    places: Table  # (B, 8) centre, half sizes, cosine and sine of the turn; metres
    patterns: npt.NDArray[np.int64]  # (B,)
    colours: Table  # (B, 6) two linear RGB reflectances


HALF, COS, SIN = 3, 6, 7
"""Columns of `Boxes.places`: where the half sizes begin, and the turn."""


@kernel(error_model="numpy")
def vector_at(table: Any, row: int, column: int) -> Vector:
    """Three columns of a row, from `column` on."""
    return table[row, column], table[row, column + 1], table[row, column + 2]


@kernel(error_model="numpy")
def minus(a: Vector, b: Vector) -> Vector:
    return a[0] - b[0], a[1] - b[1], a[2] - b[2]


@kernel(error_model="numpy")
def dot(a: Vector, b: Vector) -> float:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@kernel(error_model="numpy")
def ahead(o: Vector, d: Vector, t: float) -> Vector:
    """The place t further along d."""
    return o[0] + t * d[0], o[1] + t * d[1], o[2] + t * d[2]


@kernel(error_model="numpy")
def unit(v: Vector) -> Vector:
    n = 1.0 / math.sqrt(max(1e-30, dot(v, v)))
    return v[0] * n, v[1] * n, v[2] * n


@kernel(error_model="numpy")
def turned(v: Vector, cos: float, sin: float) -> Vector:
    """A vector of the world in the axes of a box with that turn."""
    return cos * v[0] + sin * v[2], v[1], cos * v[2] - sin * v[0]


@kernel(error_model="numpy")
def in_box(p: Vector, places: Table, i: int) -> Vector:
    """A place of the world as seen from the middle of a box, along its axes."""
    return turned(minus(p, vector_at(places, i, 0)), places[i, COS], places[i, SIN])


@kernel(error_model="numpy")
def hit_sphere(o: Vector, d: Vector, c: Vector, radius: float) -> float:
    """Distance to the first crossing ahead, or inf."""
    m = minus(o, c)
    b = dot(m, d)
    h = b * b - dot(m, m) + radius * radius
    if h < 0:
        return math.inf
    t = -b - math.sqrt(h)
    return t if t > 0 else math.inf


@kernel(error_model="numpy")
def part_axis(cones: Table, i: int) -> Vector:
    """From the centre of a part's first sphere to that of its second."""
    return minus(vector_at(cones, i, SECOND), vector_at(cones, i, FIRST))


@kernel(error_model="numpy")
def hit_part(o: Vector, d: Vector, cones: Table, i: int) -> float:
    """Distance to the hull of the part's two spheres, or inf; o lies outside.

    On the flank, with y along the axis from the first centre, x away from it and s = (ra - rb) /
    length, c = sqrt(1 - s^2): c x + s y = ra, hence c^2 (|p - a|^2 - y^2) = (ra - s y)^2, a
    quadratic in the ray's t. It bounds the hull where the normal through the point meets the axis
    between the centres.
    """
    if hit_sphere(o, d, vector_at(cones, i, AROUND), cones[i, AROUND + RADIUS]) == math.inf:
        return math.inf
    a, ra, rb = vector_at(cones, i, FIRST), cones[i, FIRST + RADIUS], cones[i, SECOND + RADIUS]
    t = hit_sphere(o, d, a, ra)
    axis, m = part_axis(cones, i), minus(o, a)
    length = math.sqrt(dot(axis, axis))
    if length < 1e-6:
        return t
    t = min(t, hit_sphere(o, d, vector_at(cones, i, SECOND), rb))
    axis = (axis[0] / length, axis[1] / length, axis[2] / length)
    md, mm = dot(m, d), dot(m, m)
    s = (ra - rb) / length
    cc = 1.0 - s * s
    oy, dy = dot(m, axis), dot(d, axis)
    k2 = cc - dy * dy
    k1 = cc * (md - oy * dy) + s * dy * (ra - s * oy)
    k0 = cc * (mm - oy * oy) - (ra - s * oy) ** 2
    h = k1 * k1 - k2 * k0
    if cc <= 0 or h < 0 or abs(k2) < 1e-12:
        return t
    h = math.sqrt(h)
    for root in ((-k1 - h) / k2, (-k1 + h) / k2):
        if 0 < root < t:
            y = oy + root * dy
            x = ra - s * y  # c times the distance from the axis
            if x > 0 and 0 <= y - s * x / cc <= length:
                t = root
    return t


@kernel(error_model="numpy")
def part_foot(p: Vector, cones: Table, i: int) -> float:
    """Where on the axis, 0..1, the normal through a surface point starts."""
    ra, rb = cones[i, FIRST + RADIUS], cones[i, SECOND + RADIUS]
    m, axis = minus(p, vector_at(cones, i, FIRST)), part_axis(cones, i)
    length = math.sqrt(dot(axis, axis))
    if length < 1e-6:
        return 0.0
    y = dot(m, axis) / length
    x = math.sqrt(max(0.0, dot(m, m) - y * y))
    s = (ra - rb) / length
    h = (y - x * s / math.sqrt(max(1e-9, 1.0 - s * s))) / length
    return float(min(1.0, max(0.0, h)))


@kernel(error_model="numpy")
def hit_box(o: Vector, d: Vector, places: Table, i: int) -> tuple[float, int]:
    """(distance, axis of the face) of the first crossing from outside, or inf."""
    start = in_box(o, places, i)
    way = turned(d, places[i, COS], places[i, SIN])
    near, far, face = -math.inf, math.inf, 0
    for axis in range(3):
        origin, slope, half = start[axis], way[axis], places[i, HALF + axis]
        if abs(slope) < 1e-12:
            if abs(origin) > half:
                return math.inf, 0
            continue
        centre, extent = -origin / slope, abs(half / slope)
        if centre - extent > near:
            near, face = centre - extent, axis
        far = min(far, centre + extent)
    if near > far or near <= 0:
        return math.inf, 0
    return near, face
