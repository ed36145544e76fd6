"""Colours of the synthetic scene: procedural patterns, a function of the place on a surface alone.

All colours are linear RGB reflectances 0..1. Nothing here looks at the viewer, so the scene is
Lambertian: what a capture of it needs to be explained by Gaussians without view-dependent colour.
"""

from __future__ import annotations

import math

from codec.kernel import kernel

from .solid import HALF, Boxes, Parts, Table, Vector, vector_at

Rgb = tuple[float, float, float]

PLAIN, STRIPES, FACE, BALL, SHOE, LAMP, LEAF, CRATE, BOOKS, WOOD, JEANS = range(11)
"""Patterns of solids."""

FLOOR, CEILING, BACK, FRONT, LEFT, RIGHT = range(6)
"""Faces of the room."""

BLOBS, SUNSET, BLOCKS, ARCHES, WINDOW = range(5)
"""Pictures on the walls."""

RUG_RADIUS_M = 1.85


def linear(hex_colour: str) -> Rgb:
    """The linear reflectance of an sRGB colour "rrggbb"."""
    values = [int(hex_colour[i : i + 2], 16) / 255 for i in (0, 2, 4)]
    r, g, b = (v / 12.92 if v <= 0.04045 else ((v + 0.055) / 1.055) ** 2.4 for v in values)
    return r, g, b


_WHITE, _CREAM, _INK = linear("f4f1ea"), linear("efe3cc"), linear("23262e")
_OAK, _OAK_DARK = linear("b98a5a"), linear("8f6238")
_PLASTER, _CLAY, _SAND, _SAGE = map(linear, ("3f6f7d", "c9775a", "e3c596", "9db28f"))
_RED, _YELLOW, _BLUE, _PINK = map(linear, ("d8432f", "f2b632", "2c5fa8", "e58fa0"))
_TEAL, _ORANGE = linear("2f7f86"), linear("f0803c")
_SKY, _SKY_HIGH, _HILL, _DUSK = map(linear, ("cfe6f2", "6fb0dc", "6f9a5c", "4a2f63"))
_SKIN, _HAIR, _BLUSH = linear("e8b48f"), linear("4b2a1d"), linear("dc8872")

_RUG = (0.26, _YELLOW), (0.2, _CREAM), (0.1, _TEAL)
"""The rug's rings, from the inmost: how far each reaches in from the rug's edge, metres."""
_SPINES = (0.86, _CLAY), (0.72, _BLUE), (0.55, _YELLOW), (0.38, _TEAL), (0.2, _RED)
"""Books: the share of them that has this colour or one after it."""
_SPOTS = _PINK, _YELLOW, _SKY_HIGH, _ORANGE
_ARCHES = _CLAY, _TEAL, _CREAM


@kernel(error_model="numpy")
def mix(a: Rgb, b: Rgb, t: float) -> Rgb:
    """a at t = 0, b at t = 1."""
    return a[0] + (b[0] - a[0]) * t, a[1] + (b[1] - a[1]) * t, a[2] + (b[2] - a[2]) * t


@kernel(error_model="numpy")
def toned(colour: Rgb, tone: float) -> Rgb:
    """A colour made darker or lighter."""
    return colour[0] * tone, colour[1] * tone, colour[2] * tone


@kernel(error_model="numpy")
def step(low: float, high: float, x: float) -> float:
    """0 below low, 1 above high, smooth between."""
    t = min(1.0, max(0.0, (x - low) / (high - low)))
    return t * t * (3.0 - 2.0 * t)


@kernel(error_model="numpy")
def lattice(ix: int, iy: int, iz: int, seed: int) -> float:
    """A fixed random number in [0, 1) for each lattice point."""
    mask = 0xFFFFFFFF
    h = (ix * 73856093 ^ iy * 19349663 ^ iz * 83492791 ^ seed * 40503) & mask
    h = ((h ^ (h >> 15)) * 739981) & mask
    h = ((h ^ (h >> 13)) * 961748) & mask
    h = ((h ^ (h >> 16)) * 668265) & mask
    return ((h ^ (h >> 15)) & 0xFFFFFF) / 16777216.0


@kernel(error_model="numpy")
def noise(x: float, y: float, z: float, seed: int) -> float:
    """Smooth random values 0..1 with one feature per unit."""
    ix, iy, iz = math.floor(x), math.floor(y), math.floor(z)
    u, v, w = x - ix, y - iy, z - iz
    u, v, w = u * u * (3 - 2 * u), v * v * (3 - 2 * v), w * w * (3 - 2 * w)
    total = 0.0
    for i in range(2):
        for j in range(2):
            for k in range(2):
                weight = (u if i else 1 - u) * (v if j else 1 - v) * (w if k else 1 - w)
                total += weight * lattice(ix + i, iy + j, iz + k, seed)
    return total


@kernel(error_model="numpy")
def grain(colour: Rgb, x: float, y: float, z: float, strength: float, seed: int) -> Rgb:
    """The colour made lighter and darker by two octaves of noise."""
    n = 0.65 * noise(x, y, z, seed) + 0.35 * noise(2.7 * x, 2.7 * y, 2.7 * z, seed + 1)
    return toned(colour, 1.0 + strength * (2.0 * n - 1.0))


@kernel(error_model="numpy")
def paint_floor(x: float, z: float, seed: int) -> Rgb:
    """Oak boards, and in the middle a round rug with checks and two rings."""
    r = math.sqrt(x * x + z * z)
    if r < RUG_RADIUS_M:
        even = (math.floor(x / 0.42 + 0.5) + math.floor(z / 0.42 + 0.5)) % 2 == 0
        colour = _CREAM if even else _TEAL
        for reach, ring in _RUG:
            if r > RUG_RADIUS_M - reach:
                colour = ring
        return grain(colour, 9 * x, 0.0, 9 * z, 0.16, seed)
    board = math.floor(x / 0.28)
    shift = lattice(board, 0, 0, seed) * 1.7
    along = (z + shift) / 1.7
    end = math.floor(along)
    colour = mix(_OAK_DARK, _OAK, 0.35 + 0.65 * lattice(board, end, 1, seed))
    colour = grain(colour, 26 * x, 0.0, 2.2 * z, 0.22, seed + 3)
    gap = min(abs(x / 0.28 - board - 0.5), 0.5)
    seam = max(step(0.47, 0.5, gap), step(0.488, 0.5, abs(along - end - 0.5)))
    return mix(colour, mix(colour, _INK, 0.7), seam)


@kernel(error_model="numpy")
def paint_picture(kind: int, u: float, v: float, seed: int) -> Rgb:
    """A picture at u (left to right) and v (top to bottom), both 0..1, its border included."""
    if kind == WINDOW:
        if min(u, 1 - u, v, 1 - v) < 0.05 or abs(u - 0.5) < 0.022 or abs(v - 0.42) < 0.02:
            return _WHITE
        sky = mix(_SKY_HIGH, _SKY, step(0.0, 0.75, v))
        cloud = noise(4.0 * u, 7.0 * v, 0.0, seed + 11) + 0.4 * noise(9 * u, 15 * v, 0.0, seed + 12)
        sky = mix(sky, _WHITE, 0.8 * step(0.72, 1.0, cloud))
        ridge = 0.72 + 0.09 * math.sin(5.0 * u + 0.6 * seed) + 0.03 * math.sin(13.0 * u)
        return mix(
            sky, mix(_HILL, _SAGE, step(0.0, 0.3, v - ridge)), step(-0.006, 0.006, v - ridge)
        )
    edge = min(u, 1 - u, v, 1 - v)
    if edge < 0.1:
        return _INK if edge < 0.035 else _WHITE
    u, v = (u - 0.1) / 0.8, (v - 0.1) / 0.8
    if kind == SUNSET:
        colour = mix(_DUSK, _ORANGE, step(0.05, 0.6, v))
        sun = math.sqrt((u - 0.58) ** 2 + 1.6 * (v - 0.47) ** 2)
        colour = mix(_YELLOW, colour, step(0.145, 0.155, sun))
        ridge = 0.62 - 0.13 * noise(3.2 * u, 0.5, 0.0, seed + 21) - 0.05 * math.sin(9 * u)
        colour = mix(colour, _DUSK, step(-0.006, 0.006, v - ridge))
        if v > 0.74:
            colour = mix(_BLUE, _ORANGE, 0.45 * step(0.3, 0.0, abs(u - 0.58)) * (1 - v) * 4)
        return colour
    if kind == BLOCKS:
        colour = _CREAM
        if u < 0.34 and v < 0.42:
            colour = _RED
        elif u > 0.68 and v > 0.62:
            colour = _BLUE
        elif (u < 0.34 and v > 0.78) or (u > 0.68 and v < 0.2):
            colour = _YELLOW
        lines = min(min(abs(u - 0.34), abs(u - 0.68)), min(abs(v - 0.42), abs(v - 0.78)))
        if u > 0.68:
            lines = min(lines, min(abs(v - 0.62), abs(v - 0.2)))
        return mix(_INK, colour, step(0.014, 0.022, lines))
    if kind == ARCHES:
        colour = _SAND
        for i in range(5):
            radius = 0.46 - 0.085 * i
            d = math.sqrt((u - 0.5) ** 2 + min(0.0, v - 0.56) ** 2)
            if v < 0.93 and d < radius:
                colour = _ARCHES[i % 3]
        return colour
    # BLOBS: soft spots on ink, much like a scene made of Gaussians.
    colour = _INK
    for i in range(14):
        cu, cv = lattice(i, 1, 0, seed + 31), lattice(i, 2, 0, seed + 31)
        su = 0.06 + 0.12 * lattice(i, 3, 0, seed + 31)
        sv = 0.05 + 0.1 * lattice(i, 4, 0, seed + 31)
        q = ((u - cu) / su) ** 2 + ((v - cv) / sv) ** 2
        colour = mix(colour, _SPOTS[i % 4], 0.92 * math.exp(-0.5 * q))
    return colour


@kernel(error_model="numpy")
def paint_room(face: int, p: Vector, wall_pictures: Table, seed: int) -> Rgb:
    """The colour of a face of the room at a place on it."""
    x, y, z = p
    if face == FLOOR:
        return paint_floor(x, z, seed)
    if face == CEILING:
        beam = abs((x + 0.6) / 1.2 - math.floor((x + 0.6) / 1.2) - 0.5)
        return grain(_OAK_DARK if beam < 0.07 else _WHITE, 5 * x, 0.0, 1.2 * z, 0.08, seed)
    # u grows to the right as one looks at the wall.
    u, wall = x, _PLASTER
    if face == FRONT:
        u, wall = -x, _SAGE
    elif face == LEFT:
        u, wall = z, _SAND
    elif face == RIGHT:
        u, wall = -z, _CLAY
    h = -y
    for i in range(wall_pictures.shape[0]):
        picture = wall_pictures[i]
        if int(picture[0]) == face:
            pu = (u - picture[1]) / picture[3] + 0.5
            pv = 0.5 - (h - picture[2]) / picture[4]
            if 0 < pu < 1 and 0 < pv < 1:
                return paint_picture(int(picture[5]), pu, pv, seed)
    if h < 0.12:
        return _WHITE
    if h < 0.92:
        panel = u / 0.62 - math.floor(u / 0.62)
        inset = min(min(panel, 1 - panel) * 0.62, min(h - 0.12, 0.92 - h))
        tone = 0.84 if 0.07 < inset < 0.085 else 1.0
        return toned(_CREAM, 1.06 if h > 0.87 else tone)
    return grain(wall, 1.7 * u, 1.7 * h, 3.1 * face, 0.2, seed + 5)


@kernel(error_model="numpy")
def paint_box(boxes: Boxes, i: int, p: Vector, axis: int, seed: int) -> Rgb:
    """The colour of a box at a place, as of `in_box`, on the face across `axis`."""
    pattern = boxes.patterns[i]
    a, b = vector_at(boxes.colours, i, 0), vector_at(boxes.colours, i, 3)
    half = vector_at(boxes.places, i, HALF)
    x, y, z = p
    u, v, hu, hv = x, y, half[0], half[1]
    if axis == 0:
        u, hu = z, half[2]
    elif axis == 1:
        v, hv = z, half[2]
    if pattern == CRATE:
        edge = min(hu - abs(u), hv - abs(v))
        diagonal = abs(u / hu - v / hv)
        if edge < 0.055 or diagonal < 0.17:
            fine = 20 if edge < 0.055 else 15
            return grain(b, fine * u, fine * v, 1.0 * axis, 0.15, seed + i)
        board = (v + hv) / 0.11
        tone = 0.6 if board - math.floor(board) < 0.09 else 1.0
        return grain(toned(a, tone), 5 * u, 22 * v, 1.0 * axis, 0.2, seed)
    if pattern == BOOKS and axis == 2:
        shelf = (y + half[1]) / 0.4
        level, rise = math.floor(shelf), shelf - math.floor(shelf)
        if rise > 0.9 or min(hu - abs(u), hv - abs(v)) < 0.03:
            return a
        book = math.floor((x + half[0]) / 0.065)
        pick = lattice(book, level, i, seed)
        if rise < 0.12 + 0.4 * lattice(book, level, i + 1, seed):
            return toned(a, 0.3)
        spine = _CREAM
        for share, colour in _SPINES:
            if pick < share:
                spine = colour
        return spine
    if pattern == WOOD:
        return grain(a, 3 * u, 18 * v, 1.0 * axis, 0.2, seed + i)
    return grain(a, 6 * x, 6 * y, 6 * z, 0.1, seed + i)


@kernel(error_model="numpy")
def paint_part(parts: Parts, i: int, local: Vector, along_m: float, seed: int) -> Rgb:
    """The colour of a part.

    local: the place as seen from the first centre, along the pattern's axes, in units of the first
    radius; along_m: metres along the part's axis.
    """
    pattern = parts.patterns[i]
    a, b = vector_at(parts.colours, i, 0), vector_at(parts.colours, i, 3)
    x, y, z = local
    if pattern == STRIPES:
        t = along_m / 0.1
        return a if t - math.floor(t) < 0.55 else b
    if pattern == FACE:
        if y > 0.3 + 0.25 * math.cos(3.0 * x) * z - 0.75 * (1.0 - z) * (0.9 if z < 0.55 else 0.2):
            return grain(_HAIR, 9 * x, 3 * y, 9 * z, 0.35, seed)
        if z > 0:
            eye = math.sqrt(((abs(x) - 0.36) / 0.1) ** 2 + ((y - 0.06) / 0.15) ** 2)
            if eye < 1:
                glint = (abs(x) - 0.39) ** 2 + (y - 0.12) ** 2
                return _WHITE if glint < 0.0016 else _INK
            smile = y + 0.42 - 0.7 * x * x
            if abs(smile) < 0.045 and abs(x) < 0.32:
                return _RED
            blush = math.sqrt((abs(x) - 0.56) ** 2 + (y + 0.2) ** 2)
            return mix(_BLUSH, _SKIN, step(0.08, 0.22, blush))
        return _SKIN
    if pattern == BALL:
        seam = min(min(abs(x), abs(y)), abs(math.sqrt((abs(x) - 1.12) ** 2 + y * y) - 0.72))
        return mix(b, grain(a, 5 * x, 5 * y, 5 * z, 0.08, seed), step(0.03, 0.055, seam))
    if pattern == SHOE:
        return b if y < -0.45 else a
    if pattern == JEANS:
        return grain(a, 6 * x, 14 * along_m, 6 * z, 0.22, seed)
    if pattern == LEAF:
        return mix(a, b, step(0.25, 0.8, noise(3.5 * x, 3.5 * y, 3.5 * z, seed + i)))
    return grain(a, 3 * x, 3 * y, 3 * z, 0.06, seed + i)
