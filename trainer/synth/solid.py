"""Rays against the solids of the synthetic scene: spheres, round cones, boxes.

A round cone is the hull of two spheres, a row of (first centre, its radius, second centre, its
radius, centre and radius of a sphere around the hull); a box is turned about the vertical, a row
of (centre, half sizes, cosine and sine). Directions are unit vectors, distances metres, and inf
where nothing is hit.
"""

from __future__ import annotations

import math
from typing import Any

from codec.kernel import kernel

Vector = tuple[float, float, float]


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
def hit_sphere(o: Vector, d: Vector, c: Vector, radius: float) -> float:
    """Distance to the first crossing ahead, or inf."""
    m = (o[0] - c[0], o[1] - c[1], o[2] - c[2])
    b = dot(m, d)
    h = b * b - dot(m, m) + radius * radius
    if h < 0:
        return math.inf
    t = -b - math.sqrt(h)
    return t if t > 0 else math.inf


@kernel(error_model="numpy")
def hit_part(o: Vector, d: Vector, parts: Any, i: int) -> float:
    """Distance to the hull of the part's two spheres, or inf; o lies outside.

    On the flank, with y along the axis from the first centre, x away from it and s = (ra - rb) /
    length, c = sqrt(1 - s^2): c x + s y = ra, hence c^2 (|p - a|^2 - y^2) = (ra - s y)^2, a
    quadratic in the ray's t. It bounds the hull where the normal through the point meets the axis
    between the centres.
    """
    t = hit_sphere(o, d, (parts[i, 8], parts[i, 9], parts[i, 10]), parts[i, 11])
    if t == math.inf:
        return math.inf
    a = (parts[i, 0], parts[i, 1], parts[i, 2])
    ra, rb = parts[i, 3], parts[i, 7]
    t = hit_sphere(o, d, a, ra)
    axis = (parts[i, 4] - a[0], parts[i, 5] - a[1], parts[i, 6] - a[2])
    m = (o[0] - a[0], o[1] - a[1], o[2] - a[2])
    length = math.sqrt(dot(axis, axis))
    md, mm = dot(m, d), dot(m, m)
    if length < 1e-6:
        return t
    t = min(t, hit_sphere(o, d, (parts[i, 4], parts[i, 5], parts[i, 6]), rb))
    axis = (axis[0] / length, axis[1] / length, axis[2] / length)
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
def part_foot(p: Vector, parts: Any, i: int) -> float:
    """Where on the axis, 0..1, the normal through a surface point starts."""
    ra, rb = parts[i, 3], parts[i, 7]
    m = (p[0] - parts[i, 0], p[1] - parts[i, 1], p[2] - parts[i, 2])
    axis = (parts[i, 4] - parts[i, 0], parts[i, 5] - parts[i, 1], parts[i, 6] - parts[i, 2])
    length = math.sqrt(dot(axis, axis))
    if length < 1e-6:
        return 0.0
    y = dot(m, axis) / length
    x = math.sqrt(max(0.0, dot(m, m) - y * y))
    s = (ra - rb) / length
    h = (y - x * s / math.sqrt(max(1e-9, 1.0 - s * s))) / length
    return float(min(1.0, max(0.0, h)))


@kernel(error_model="numpy")
def hit_box(o: Vector, d: Vector, boxes: Any, i: int) -> tuple[float, int]:
    """(distance, axis of the face) of the first crossing from outside, or inf."""
    cos, sin = boxes[i, 6], boxes[i, 7]
    x, y, z = o[0] - boxes[i, 0], o[1] - boxes[i, 1], o[2] - boxes[i, 2]
    ox, oz = cos * x + sin * z, cos * z - sin * x
    dx, dz = cos * d[0] + sin * d[2], cos * d[2] - sin * d[0]
    near, far, face = -math.inf, math.inf, 0
    for axis in range(3):
        origin, slope = (ox, dx) if axis == 0 else ((y, d[1]) if axis == 1 else (oz, dz))
        half = boxes[i, 3 + axis]
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
