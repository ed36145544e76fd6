"""Light in the synthetic scene: one soft lamp, a fill without shadow, and ambient light.

Ambient light comes from above and below and is darkened by what is near. All of it depends on the
place alone, not on the viewer.
"""

from __future__ import annotations

import math
from typing import Any

from codec.kernel import kernel

from .paint import LAMP, Rgb, mix
from .solid import (
    AROUND,
    FIRST,
    GROUP_CENTRE,
    GROUP_END,
    GROUP_FIRST,
    GROUP_RADIUS,
    GROUP_REACH,
    HALF,
    RADIUS,
    SECOND,
    Table,
    Vector,
    ahead,
    dot,
    hit_box,
    in_box,
    minus,
    part_axis,
    vector_at,
)

LAMP_RADIUS_M = 0.3
"""Radius of the lamp as a light: how soft shadows are."""
LAMP_FULL_M = 2.9
"""Distance at which the lamp gives its nominal light."""
LAMP_LIGHT: Rgb = (1.95, 1.76, 1.44)

REACH_RADII = 7.0
"""How far a part darkens the ambient light, in its radii."""

_AMBIENT_UP: Rgb = (0.40, 0.41, 0.43)
_AMBIENT_DOWN: Rgb = (0.23, 0.20, 0.18)
_FILL: Rgb = (0.20, 0.25, 0.31)
_FILL_TO: Vector = (-0.64, -0.45, -0.62)
_EXPOSURE = 1.25


@kernel(error_model="numpy")
def light_of_lamp(p: Vector, n: Vector, lamp: Any) -> float:
    """The unshadowed lamp's light on a surface, in its nominal strength."""
    v = minus(lamp, p)
    d2 = dot(v, v)
    cosine = dot(v, n) / math.sqrt(d2)
    return max(0.0, cosine) * min(2.0, LAMP_FULL_M * LAMP_FULL_M / (d2 + 0.5))


@kernel(error_model="numpy")
def shadow_of_parts(
    p: Vector, lamp: Any, cones: Table, patterns: Any, first: int, end: int, skip: int
) -> float:
    """How much of the lamp is seen from p past the parts first..end - 1, 0..1.

    Each part hides the lamp by how far the ray to its middle passes the part's axis, over the
    penumbra's half width at that distance; the part that hides most counts.
    """
    d = minus(lamp, p)
    reach = math.sqrt(dot(d, d))
    d = (d[0] / reach, d[1] / reach, d[2] / reach)
    seen = 1.0
    for i in range(first, end):
        if i == skip or patterns[i] == LAMP:
            continue
        around, around_m = minus(vector_at(cones, i, AROUND), p), cones[i, AROUND + RADIUS]
        t = dot(around, d)
        widest = around_m + LAMP_RADIUS_M * max(0.0, t + around_m) / reach + 2e-3
        if dot(around, around) - t * t > widest * widest:
            continue
        m, axis = minus(p, vector_at(cones, i, FIRST)), part_axis(cones, i)
        c, md = dot(axis, axis), dot(m, d)
        # Closest places p + t d and a + h axis: set the derivatives by t and h to zero, then clamp.
        b, ma = dot(d, axis), dot(m, axis)
        h = min(1.0, max(0.0, (ma - b * md) / (c - b * b))) if c - b * b > 1e-9 else 0.0
        t = min(reach, max(0.0, h * b - md))
        if c > 1e-9:
            h = min(1.0, max(0.0, (ma + t * b) / c))
        gap = ahead(ahead(m, d, t), axis, -h)
        soft = max(2e-3, LAMP_RADIUS_M * t / reach)
        x = (math.sqrt(dot(gap, gap)) - radius_at(cones, i, h) + soft) / (2.0 * soft)
        if x < 1.0:
            x = max(0.0, x)
            seen = min(seen, x * x * (3.0 - 2.0 * x))
    return seen


@kernel(error_model="numpy")
def radius_at(cones: Table, i: int, h: float) -> float:
    """About how thick a part is at h of its axis, 0..1."""
    first = float(cones[i, FIRST + RADIUS])
    return first + h * (float(cones[i, SECOND + RADIUS]) - first)


@kernel(error_model="numpy")
def ambient_of_parts(p: Vector, n: Vector, cones: Table, first: int, end: int, skip: int) -> float:
    """How much ambient light the parts first..end - 1 leave at p, 0..1."""
    left = 1.0
    for i in range(first, end):
        if i == skip:
            continue
        around = minus(vector_at(cones, i, AROUND), p)
        thickest = max(cones[i, FIRST + RADIUS], cones[i, SECOND + RADIUS])
        reach = cones[i, AROUND + RADIUS] + (REACH_RADII - 1.0) * thickest
        if dot(around, around) > reach * reach:
            continue
        m, axis = minus(p, vector_at(cones, i, FIRST)), part_axis(cones, i)
        c = dot(axis, axis)
        h = min(1.0, max(0.0, dot(m, axis) / c)) if c > 1e-9 else 0.0
        radius = radius_at(cones, i, h)
        v = (h * axis[0] - m[0], h * axis[1] - m[1], h * axis[2] - m[2])
        d2 = max(dot(v, v), 1e-9)
        facing = dot(v, n) / math.sqrt(d2)
        if facing > 0:
            # A sphere's share of the sky; the tail is cut, so that it ends at REACH_RADII.
            solid = facing * min(1.0, radius * radius / d2) - 1.0 / REACH_RADII**2
            left *= 1.0 - 0.75 * max(0.0, solid)
    return left


@kernel(error_model="numpy")
def ambient_of_room(p: Vector, n: Vector, places: Table, room: Table) -> float:
    """How much ambient light the room's corners and boxes leave at p, 0..1.

    room: half its width and its height, metres.
    """
    left = 1.0
    for axis in range(3):
        if abs(n[axis]) > 0.9:
            continue
        low = room[0] + p[axis] if axis != 1 else room[1] + p[1]
        high = room[0] - p[axis] if axis != 1 else -p[1]
        left *= 1.0 - 0.42 * math.exp(-max(0.0, low) / 0.22)
        left *= 1.0 - 0.42 * math.exp(-max(0.0, high) / 0.22)
    for i in range(places.shape[0]):
        at, gap = in_box(p, places, i), 0.0
        for axis in range(3):
            gap += max(0.0, abs(at[axis]) - places[i, HALF + axis]) ** 2
        gap = math.sqrt(gap)
        if 1e-6 < gap < 1.2:
            left *= 1.0 - 0.5 * math.exp(-gap / 0.14)
    return left


@kernel(error_model="numpy")
def passes_by(p: Vector, to: Vector, centre: Vector, radius: float) -> bool:
    """Whether the way from p to p + to comes nearer to a centre than the radius."""
    v = minus(centre, p)
    along = min(1.0, max(0.0, dot(v, to) / dot(to, to)))
    e = ahead(v, to, -along)
    return dot(e, e) < radius**2


@kernel(error_model="numpy")
def lamp_past_boxes(p: Vector, n: Vector, lamp: Any, places: Table) -> float:
    """The share of the lamp that the boxes leave in sight, of 4 x 4 places on its disc."""
    o = ahead(p, n, 1e-4)
    to = minus(lamp, o)
    near = 0  # bits of the boxes that come near the way to the lamp
    for i in range(places.shape[0]):
        half = vector_at(places, i, HALF)
        radius = math.sqrt(dot(half, half))
        if passes_by(o, to, vector_at(places, i, 0), radius + LAMP_RADIUS_M):
            near |= 1 << i
    if near == 0:
        return 1.0
    seen = 0
    for spot in range(16):
        sx = ((spot % 4) - 1.5) / 2.0 * LAMP_RADIUS_M
        sz = ((spot // 4) - 1.5) / 2.0 * LAMP_RADIUS_M
        to = (lamp[0] + sx - o[0], lamp[1] - o[1], lamp[2] + sz - o[2])
        reach = math.sqrt(dot(to, to))
        d = (to[0] / reach, to[1] / reach, to[2] / reach)
        free = 1
        for i in range(places.shape[0]):
            if near & (1 << i) and hit_box(o, d, places, i)[0] < reach:
                free = 0
                break
        seen += free
    return seen / 16.0


@kernel(error_model="numpy")
def light_past_groups(
    p: Vector, n: Vector, lamp: Any, cones: Table, patterns: Any, groups: Table, skip: int
) -> tuple[float, float]:
    """(ambient, lamp): what the groups of moving parts leave of either light at p, 0..1."""
    ambient, key = 1.0, 1.0
    to = minus(lamp, p)
    for g in range(groups.shape[0]):
        first, end = int(groups[g, GROUP_FIRST]), int(groups[g, GROUP_END])
        centre, radius = vector_at(groups, g, GROUP_CENTRE), groups[g, GROUP_RADIUS]
        v = minus(centre, p)
        if dot(v, v) < (radius + groups[g, GROUP_REACH]) ** 2:
            ambient *= ambient_of_parts(p, n, cones, first, end, skip)
        if passes_by(p, to, centre, radius + LAMP_RADIUS_M) and dot(n, to) > 0:
            key *= shadow_of_parts(p, lamp, cones, patterns, first, end, skip)
    return ambient, key


@kernel(error_model="numpy")
def ambient_light(n: Vector) -> Rgb:
    """Light from everywhere but the lamp on a free surface."""
    light = mix(_AMBIENT_DOWN, _AMBIENT_UP, 0.5 - 0.5 * n[1])
    return ahead(light, _FILL, max(0.0, dot(n, _FILL_TO)))


@kernel(error_model="numpy")
def encode(light: float) -> int:
    """The 8-bit sRGB value of linear light, rolled off towards white."""
    v = 1.0 - math.exp(-_EXPOSURE * light)
    v = 12.92 * v if v <= 0.0031308 else 1.055 * v ** (1 / 2.4) - 0.055
    return int(255.0 * v + 0.5)
