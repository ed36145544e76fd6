"""Surfaces of the synthetic scene as flat Gaussians: where they lie, their light, and their
procedural patterns.

Rule: nothing here looks at the viewer, so the scene is Lambertian: what a capture of it needs to be
explained by Gaussians without view-dependent colour. All colours are linear RGB reflectances 0..1.
Surfaces are painted at u, v metres from their upper left corner, solids at places seen from their
middle.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
from scipy.ndimage import map_coordinates

from codec.arrays import Doubles, Flags, Floats, Ints
from codec.kernel import kernel, prange
from codec.splats import SH_C0, Splats

Flat = Callable[[Doubles, Doubles, float, float, int], Doubles]
"""Paints (N,) places u, v on a surface of a width and a height, metres, with a seed: (N, 3)."""

Solid = Callable[[Doubles, Doubles, int], Doubles]
"""Paints (N, 3) places right, up and forward from the middle, in radii, and (N,) metres along the
axis, with a seed: (N, 3)."""

RUG_RADIUS_M = 1.85


def linear(hex_colour: str) -> Doubles:
    """(3,) the linear reflectance of an sRGB colour "rrggbb"."""
    values = np.array([int(hex_colour[i : i + 2], 16) / 255 for i in (0, 2, 4)])
    light: Doubles = np.where(values <= 0.04045, values / 12.92, ((values + 0.055) / 1.055) ** 2.4)
    return light


WHITE, CREAM, INK = map(linear, ("f4f1ea", "efe3cc", "23262e"))
OAK, OAK_DARK, SAGE, SAND = map(linear, ("b98a5a", "8f6238", "9db28f", "e3c596"))
PLASTER, CLAY, TEAL, ORANGE = map(linear, ("3f6f7d", "c9775a", "2f7f86", "f0803c"))
RED, YELLOW, BLUE, PINK = map(linear, ("d8432f", "f2b632", "2c5fa8", "e58fa0"))
SKY, SKY_HIGH, HILL, DUSK = map(linear, ("cfe6f2", "6fb0dc", "6f9a5c", "4a2f63"))
SKIN, HAIR, BLUSH = map(linear, ("e8b48f", "4b2a1d", "dc8872"))


def mix(a: Doubles, b: Doubles, t: Doubles) -> Doubles:
    """(N, 3) a at t = 0, b at t = 1."""
    return np.asarray(a + (b - a) * t[:, None])


def step(low: float, high: float, x: Doubles) -> Doubles:
    """0 below low, 1 above high, smooth between."""
    t = np.clip((x - low) / (high - low), 0, 1)
    return np.asarray(t * t * (3 - 2 * t))


def where(holds: Flags, a: Doubles, b: Doubles) -> Doubles:
    """(N, 3) a where (N,) `holds`, else b."""
    chosen: Doubles = np.where(holds[:, None], a, b)
    return chosen


def noise(u: Doubles, v: Doubles, seed: int) -> Doubles:
    """(N,) smooth random values 0..1 with one feature per unit."""
    grid = np.random.default_rng(seed).random((64, 64))
    values: Doubles = map_coordinates(grid, [u % 64, v % 64], order=1, mode="grid-wrap")
    return values


def picks(number: Doubles, seed: int) -> Doubles:
    """(N,) a fixed random value 0..1 for each whole number."""
    values: Doubles = np.random.default_rng(seed).random(4096)[number.astype(int) % 4096]
    return values


def grain(colour: Doubles, u: Doubles, v: Doubles, strength: float, seed: int) -> Doubles:
    """The colour made lighter and darker by two octaves of noise."""
    n = 0.65 * noise(u, v, seed) + 0.35 * noise(2.7 * u, 2.7 * v, seed + 1)
    return np.asarray(colour * (1 + strength * (2 * n - 1))[:, None])


def plain(colour: str, strength: float = 0.1) -> Flat:
    """A surface of one colour."""
    return lambda u, v, width, height, seed: grain(linear(colour), 6 * u, 6 * v, strength, seed)


def wood(colour: str) -> Flat:
    return lambda u, v, width, height, seed: grain(linear(colour), 3 * u, 18 * v, 0.2, seed)


def floor(u: Doubles, v: Doubles, width: float, height: float, seed: int) -> Doubles:
    """Oak boards, and in the middle a round rug with checks and rings."""
    x, z = u - width / 2, v - height / 2
    r = np.hypot(x, z)
    is_even = (np.floor(x / 0.42 + 0.5) + np.floor(z / 0.42 + 0.5)) % 2 == 0
    rug = where(is_even, CREAM, TEAL)
    for reach, ring in (0.26, YELLOW), (0.2, CREAM), (0.1, TEAL):
        rug = where(r > RUG_RADIUS_M - reach, ring, rug)
    board, along = np.floor(x / 0.28), z / 1.7
    along = along + picks(board, seed)
    plank = picks(31 * board + np.floor(along), seed + 2)
    colour = grain(mix(OAK_DARK, OAK, 0.35 + 0.65 * plank), 26 * x, 2.2 * z, 0.22, seed + 3)
    across = np.abs(x / 0.28 - board - 0.5)
    seam = np.maximum(step(0.47, 0.5, across), step(0.488, 0.5, np.abs(along % 1 - 0.5)))
    colour = mix(colour, 0.3 * colour + 0.7 * INK, seam)
    return where(r < RUG_RADIUS_M, grain(rug, 9 * x, 9 * z, 0.16, seed), colour)


def ceiling(u: Doubles, v: Doubles, width: float, height: float, seed: int) -> Doubles:
    """White, with beams."""
    is_beam = np.abs((u - width / 2 + 0.6) / 1.2 % 1 - 0.5) < 0.07
    return grain(where(is_beam, OAK_DARK, WHITE), 5 * u, 1.2 * v, 0.08, seed)


def wall(colour: Doubles) -> Flat:
    """Plaster above white panels."""

    def paint(u: Doubles, v: Doubles, width: float, height: float, seed: int) -> Doubles:
        h, panel = height - v, (u - width / 2) / 0.62 % 1
        inset = np.minimum(np.minimum(panel, 1 - panel) * 0.62, np.minimum(h - 0.12, 0.92 - h))
        tone = np.where(h > 0.87, 1.06, np.where((inset > 0.07) & (inset < 0.085), 0.84, 1.0))
        low = where(h < 0.12, WHITE, CREAM * tone[:, None])
        return where(h < 0.92, low, grain(colour, 1.7 * u, 1.7 * v, 0.2, seed + 5))

    return paint


def crate(colour: str, frame: str) -> Flat:
    """Boards in a frame with a diagonal."""

    def paint(u: Doubles, v: Doubles, width: float, height: float, seed: int) -> Doubles:
        edge = np.minimum(np.minimum(u, width - u), np.minimum(v, height - v))
        is_frame = (edge < 0.055) | (np.abs(u / width - v / height) < 0.085)
        tone = np.where(v / 0.11 % 1 < 0.09, 0.6, 1.0)[:, None]
        boards = grain(linear(colour) * tone, 5 * u, 22 * v, 0.2, seed)
        return where(is_frame, grain(linear(frame), 20 * u, 20 * v, 0.15, seed), boards)

    return paint


def books(u: Doubles, v: Doubles, width: float, height: float, seed: int) -> Doubles:
    """Shelves full of books."""
    level, rise, book = np.floor(v / 0.4), v / 0.4 % 1, np.floor(u / 0.065)
    pick = picks(97 * level + book, seed)
    spine = np.broadcast_to(CREAM, (len(u), 3))
    for share, colour in (0.86, CLAY), (0.72, BLUE), (0.55, YELLOW), (0.38, TEAL), (0.2, RED):
        spine = where(pick < share, colour, spine)
    case = linear("7a5132")
    spine = where(rise < 0.12 + 0.4 * picks(97 * level + book, seed + 1), 0.3 * case, spine)
    edge = np.minimum(np.minimum(u, width - u), np.minimum(v, height - v))
    return where((rise > 0.9) | (edge < 0.03), case, spine)


def framed(picture: Callable[[Doubles, Doubles, int], Doubles]) -> Flat:
    """A picture, of places 0..1 from left to right and top to bottom, in a frame."""

    def paint(u: Doubles, v: Doubles, width: float, height: float, seed: int) -> Doubles:
        u, v = u / width, v / height
        edge = np.minimum(np.minimum(u, 1 - u), np.minimum(v, 1 - v))
        inner = picture((u - 0.1) / 0.8, (v - 0.1) / 0.8, seed)
        return where(edge < 0.035, INK, where(edge < 0.1, WHITE, inner))

    return paint


def window(u: Doubles, v: Doubles, width: float, height: float, seed: int) -> Doubles:
    """Clouds over a hill, behind white bars."""
    u, v = u / width, v / height
    cloud = noise(4 * u, 7 * v, seed + 11) + 0.4 * noise(9 * u, 15 * v, seed + 12)
    sky = mix(mix(SKY_HIGH, SKY, step(0, 0.75, v)), WHITE, 0.8 * step(0.72, 1, cloud))
    below = v - 0.72 - 0.09 * np.sin(5 * u + 0.6 * seed) - 0.03 * np.sin(13 * u)
    view = mix(sky, mix(HILL, SAGE, step(0, 0.3, below)), step(-0.006, 0.006, below))
    edge = np.minimum(np.minimum(u, 1 - u), np.minimum(v, 1 - v))
    is_bar = (edge < 0.05) | (np.abs(u - 0.5) < 0.022) | (np.abs(v - 0.42) < 0.02)
    return where(is_bar, WHITE, view)


def sunset(u: Doubles, v: Doubles, seed: int) -> Doubles:
    sun = np.sqrt((u - 0.58) ** 2 + 1.6 * (v - 0.47) ** 2)
    colour = mix(YELLOW, mix(DUSK, ORANGE, step(0.05, 0.6, v)), step(0.145, 0.155, sun))
    ridge = 0.62 - 0.13 * noise(3.2 * u, 0 * u, seed + 21) - 0.05 * np.sin(9 * u)
    colour = mix(colour, DUSK, step(-0.006, 0.006, v - ridge))
    shine = mix(BLUE, ORANGE, 1.8 * (1 - step(0, 0.3, np.abs(u - 0.58))) * (1 - v))
    return where(v > 0.74, shine, colour)


def blocks(u: Doubles, v: Doubles, seed: int) -> Doubles:
    """Fields of colour between black lines."""
    left, right = u < 0.34, u > 0.68
    colour = where(left & (v < 0.42), RED, np.broadcast_to(CREAM, (len(u), 3)))
    colour = where((left & (v > 0.78)) | (right & (v < 0.2)), YELLOW, colour)
    colour = where(right & (v > 0.62), BLUE, colour)
    lines = np.minimum(np.abs(u[:, None] - (0.34, 0.68)), np.abs(v[:, None] - (0.42, 0.78)))
    return where(lines.min(axis=1) < 0.013, INK, colour)


def arches(u: Doubles, v: Doubles, seed: int) -> Doubles:
    d = np.sqrt((u - 0.5) ** 2 + np.minimum(0, v - 0.56) ** 2)
    colour = np.broadcast_to(SAND, (len(u), 3))
    for i, arch in enumerate((CLAY, TEAL, CREAM, CLAY, TEAL)):
        colour = where((v < 0.93) & (d < 0.46 - 0.085 * i), arch, colour)
    return colour


def blobs(u: Doubles, v: Doubles, seed: int) -> Doubles:
    """Soft spots on ink, much like a scene made of Gaussians."""
    colour = np.broadcast_to(INK, (len(u), 3))
    rows = np.random.default_rng(seed + 31).random((14, 4))
    for i, (x, y, wide, high) in enumerate(rows):
        q = ((u - x) / (0.06 + 0.12 * wide)) ** 2 + ((v - y) / (0.05 + 0.1 * high)) ** 2
        colour = mix(colour, (PINK, YELLOW, SKY_HIGH, ORANGE)[i % 4], 0.92 * np.exp(-0.5 * q))
    return colour


def even(colour: str, strength: float = 0.06) -> Solid:
    """A solid of one colour."""
    return lambda p, along_m, seed: grain(
        linear(colour), 3 * (p[:, 0] + p[:, 2]), 3 * p[:, 1] + 14 * along_m, strength, seed
    )


def stripes(first: str, second: str) -> Solid:
    return lambda p, along_m, seed: where(
        along_m / 0.1 % 1 < 0.55, linear(first), np.tile(linear(second), (len(p), 1))
    )


def shoe(p: Doubles, along_m: Doubles, seed: int) -> Doubles:
    return where(p[:, 1] < -0.45, WHITE, np.tile(linear("c9372c"), (len(p), 1)))


def ball(p: Doubles, along_m: Doubles, seed: int) -> Doubles:
    x, y, _ = np.abs(p).T
    seam = np.minimum(np.minimum(x, y), np.abs(np.hypot(x - 1.12, y) - 0.72))
    leather = grain(linear("ef7d1f"), 5 * p[:, 0], 5 * p[:, 1], 0.08, seed)
    return mix(linear("2a1a14"), leather, step(0.045, 0.06, seam))


def face(p: Doubles, along_m: Doubles, seed: int) -> Doubles:
    """Eyes, a smile and hair."""
    x, y, z = np.abs(p[:, 0]), p[:, 1], p[:, 2]
    colour = mix(BLUSH, SKIN, step(0.08, 0.22, np.hypot(x - 0.56, y + 0.2)))
    is_smile = (np.abs(y + 0.42 - 0.7 * x * x) < 0.045) & (x < 0.32)
    colour = where(is_smile, RED, colour)
    is_eye = np.hypot((x - 0.36) / 0.11, (y - 0.06) / 0.17) < 1
    colour = where(is_eye, INK, colour)
    colour = where(z > 0, colour, SKIN)
    line = 0.3 + 0.25 * np.cos(3 * x) * z - 0.75 * (1 - z) * np.where(z < 0.55, 0.9, 0.2)
    return where(y > line, grain(HAIR, 9 * p[:, 0], 3 * y, 0.35, seed), colour)


LAMP_AT = np.array([0.5, -2.72, -0.45])
"""The middle of the lamp, metres."""
LAMP_RADIUS_M = 0.3
"""Radius of the lamp as a light: how soft shadows are."""
LAMP_FULL_M = 2.9
"""Distance at which the lamp gives its nominal light."""
LAMP_LIGHT = np.array([1.95, 1.76, 1.44])
AMBIENT_UP, AMBIENT_DOWN = np.array([0.40, 0.41, 0.43]), np.array([0.23, 0.20, 0.18])
FILL, FILL_TO = np.array([0.20, 0.25, 0.31]), np.array([-0.64, -0.45, -0.62])
EXPOSURE = 1.25

REACH_RADII = 7.0
"""How far a round cone darkens the ambient light, in its radii."""
OVERLAP = 0.55
"""Standard deviation of a surfel, as a share of the distance to the next one."""
LOGIT_OPACITY = 3.0


@dataclass(frozen=True, slots=True, eq=False)
class Cone:
    """The hull of two spheres."""

    first: Doubles  # (3,) metres
    first_radius_m: float
    second: Doubles  # (3,) metres
    second_radius_m: float
    axes: Doubles  # (3, 3) unit vectors right, up, forward of the pattern
    paint: Solid

    def row(self) -> list[float]:
        """(8,) both centres and radii, as `past_cones` wants them."""
        return [*self.first, self.first_radius_m, *self.second, self.second_radius_m]

    def thinner(self, by_m: float) -> Cone:
        """The cone with smaller radii, but for very thin ones."""
        first_m, second_m = self.first_radius_m, self.second_radius_m
        first_m, second_m = max(first_m - by_m, first_m / 2), max(second_m - by_m, second_m / 2)
        return replace(self, first_radius_m=first_m, second_radius_m=second_m)


def upright(forward: Doubles) -> Doubles:
    """(3, 3) unit vectors right, up and forward of what looks there, upright."""
    up = np.array([0.0, -1.0, 0.0])
    return np.stack([np.cross(-up, forward), up, forward])


def cone(
    look: str | Solid,
    first: npt.ArrayLike,
    first_radius_m: float,
    second: npt.ArrayLike | None = None,
    second_radius_m: float | None = None,
    axes: Doubles | None = None,
) -> Cone:
    """A round cone of a colour or a pattern, or a sphere when there is no second centre.

    axes: of the pattern; by default it looks along -z.
    """
    return Cone(
        np.asarray(first, np.float64),
        first_radius_m,
        np.asarray(first if second is None else second, np.float64),
        first_radius_m if second_radius_m is None else second_radius_m,
        upright(np.array([0.0, 0.0, -1.0])) if axes is None else axes,
        even(look) if isinstance(look, str) else look,
    )


class Surfels(NamedTuple):
    """N small discs."""

    places: Floats  # (N, 3) metres
    normals: Floats  # (N, 3) unit vectors
    colours: Floats  # (N, 3) linear reflectances
    spacing_m: Floats  # (N,) to the next one
    owners: Ints  # (N,) the cone that each lies on, -1 for none

    @staticmethod
    def joined(parts: Sequence[Surfels]) -> Surfels:
        return Surfels(*map(np.concatenate, zip(*parts, strict=True)))

    def take(self, rows: Any) -> Surfels:
        return Surfels(*(array[rows] for array in self))

    def splats(self, light: Floats) -> Splats:
        """The surfels in (N, 3) light, in the colours of a display."""
        value = 1 - np.exp(-EXPOSURE * self.colours * light)
        encoded = np.where(value <= 0.0031308, 12.92 * value, 1.055 * value ** (1 / 2.4) - 0.055)
        x, y, z = self.normals.T
        # The turn of the z axis to the normal; half a turn where that points the other way.
        quats = np.stack([1 + z, -y, x, np.zeros_like(x)], axis=1)
        quats[z < -0.9999] = 0, 1, 0, 0
        wide = np.log(OVERLAP * self.spacing_m)
        return Splats(
            self.places,
            np.stack([wide, wide, wide - 3], axis=1),
            quats,
            np.full(len(x), LOGIT_OPACITY, np.float32),
            ((encoded - 0.5) / SH_C0).astype(np.float32)[:, None],
        )


def rectangle(
    corner: Doubles, right: Doubles, down: Doubles, paint: Flat, spacing_m: float, seed: int
) -> Surfels:
    """The surfels of a rectangle that spans `right` and `down`, metres, from its upper left corner
    as seen from the front."""
    size = width, height = float(np.linalg.norm(right)), float(np.linalg.norm(down))
    across, along = (max(1, round(side / spacing_m)) for side in size)
    v, u = np.divide(np.mgrid[:along, :across].reshape(2, -1) + 0.5, [[along], [across]])
    places = corner + u[:, None] * right + v[:, None] * down
    normals = np.tile(np.cross(down, right) / (width * height), (len(u), 1))
    return _surfels(
        places, normals, paint(width * u, height * v, width, height, seed), spacing_m, -1
    )


def _surfels(
    places: Doubles, normals: Doubles, colours: Doubles, spacing_m: float, owner: int
) -> Surfels:
    return Surfels(
        places.astype(np.float32),
        normals.astype(np.float32),
        colours.astype(np.float32),
        np.full(len(places), spacing_m, np.float32),
        np.full(len(places), owner, np.int32),
    )


def cone_surfels(cones: Sequence[Cone], spacing_m: float, seed: int) -> Surfels:
    """The surfels on the hulls of `cones`, which own them."""
    return Surfels.joined(
        [_cone(number, cone, spacing_m, seed + number) for number, cone in enumerate(cones)]
    )


def _cone(number: int, cone: Cone, spacing_m: float, seed: int) -> Surfels:
    a, ra, b, rb = cone.first, cone.first_radius_m, cone.second, cone.second_radius_m
    spacing_m = min(spacing_m, max(ra, rb) / 3)
    length = float(np.linalg.norm(b - a))
    axis = (b - a) / length if length > 1e-6 else np.array([0.0, 1.0, 0.0])
    # How far the normals of the flank lean along the axis.
    lean = (ra - rb) / length if length > 1e-6 else 1.0
    normals, feet = [], []
    for foot, radius, side in (0.0, ra, -1), (1.0, rb, 1):
        ways = _directions(math.ceil(4 * math.pi * (radius / spacing_m) ** 2))
        ways = ways[side * (ways @ axis - lean) >= 0]
        normals.append(ways)
        feet.append(np.full(len(ways), foot))
    if length > 1e-6:
        rows = max(1, round(length / spacing_m))
        around = max(6, round(2 * math.pi * max(ra, rb) / spacing_m))
        h, turn = np.divide(np.mgrid[:rows, :around].reshape(2, -1) + 0.5, [[rows], [around]])
        aside = np.cross(axis, np.eye(3)[np.abs(axis).argmin()])
        aside /= np.linalg.norm(aside)
        turn *= 2 * math.pi
        out = np.cos(turn)[:, None] * aside + np.sin(turn)[:, None] * np.cross(axis, aside)
        normals.append(lean * axis + math.sqrt(max(0.0, 1 - lean**2)) * out)
        feet.append(h)
    n, h = np.concatenate(normals), np.concatenate(feet)
    places = a + h[:, None] * (b - a) + (ra + h * (rb - ra))[:, None] * n
    colours = cone.paint((places - a) @ cone.axes.T / ra, h * length, seed)
    return _surfels(places, n, colours, spacing_m, number)


def _directions(count: int) -> Doubles:
    """(count, 3) unit vectors, evenly spread on a spiral."""
    n = np.arange(count) + 0.5
    z, turn = 1 - 2 * n / count, math.pi * (1 + 5**0.5) * n
    r = np.sqrt(1 - z * z)
    return np.stack([r * np.cos(turn), r * np.sin(turn), z], axis=1)


def light_of(surfels: Surfels) -> tuple[Floats, Floats]:
    """(N, 3) the ambient light from above, from below and of a fill, and the lamp's light, where
    nothing stands in the way."""
    normals, to = surfels.normals, LAMP_AT - surfels.places
    up, fill = 0.5 - 0.5 * normals[:, 1:2], np.maximum(0, normals @ FILL_TO)[:, None]
    ambient = AMBIENT_DOWN + (AMBIENT_UP - AMBIENT_DOWN) * up + FILL * fill
    d2 = (to**2).sum(axis=1)
    cosine = np.maximum(0, (to * normals).sum(axis=1)) / np.sqrt(d2)
    lamp = LAMP_LIGHT * (cosine * np.minimum(2, LAMP_FULL_M**2 / (d2 + 0.5)))[:, None]
    return ambient.astype(np.float32), lamp.astype(np.float32)


def past_cones(surfels: Surfels, cones: Sequence[Cone]) -> tuple[Floats, Floats]:
    """(N,) the shares of the ambient light and of the lamp's that cones leave; a surfel's own cone
    does not count."""
    left = np.empty((2, len(surfels.places)), np.float32)
    table = np.array([cone.row() for cone in cones])
    _past_cones(surfels.places, surfels.normals, surfels.owners, table, LAMP_AT, left)
    return left[0], left[1]


@kernel(parallel=True, error_model="numpy")
def _past_cones(  # type: ignore[no-untyped-def]
    places, normals, owners, cones, lamp, left
):
    """Each cone takes its share of the sky, and hides the lamp by how far the ray to its middle
    passes the cone's axis, over the penumbra's half width there; the cone that hides most counts.
    """
    for i in prange(places.shape[0]):
        px, py, pz = places[i, 0], places[i, 1], places[i, 2]
        dx, dy, dz = lamp[0] - px, lamp[1] - py, lamp[2] - pz
        reach = math.sqrt(dx * dx + dy * dy + dz * dz)
        dx, dy, dz = dx / reach, dy / reach, dz / reach
        ambient, key = 1.0, 1.0
        for j in range(cones.shape[0]):
            if owners[i] == j:
                continue
            ra, rb = cones[j, 3], cones[j, 7]
            mx, my, mz = px - cones[j, 0], py - cones[j, 1], pz - cones[j, 2]
            ax, ay, az = (
                cones[j, 4] - cones[j, 0], cones[j, 5] - cones[j, 1], cones[j, 6] - cones[j, 2]
            )  # fmt: skip
            aa, ma = ax * ax + ay * ay + az * az + 1e-9, mx * ax + my * ay + mz * az
            h = min(1.0, max(0.0, ma / aa))
            vx, vy, vz = h * ax - mx, h * ay - my, h * az - mz
            d2, radius = max(1e-9, vx * vx + vy * vy + vz * vz), ra + h * (rb - ra)
            facing = (vx * normals[i, 0] + vy * normals[i, 1] + vz * normals[i, 2]) / math.sqrt(d2)
            solid = facing * min(1.0, radius * radius / d2) - 1.0 / REACH_RADII**2
            ambient *= 1.0 - 0.75 * max(0.0, solid)
            # Closest places p + t d and a + h axis: set both derivatives to zero, then clamp.
            da, md = dx * ax + dy * ay + dz * az, mx * dx + my * dy + mz * dz
            h = min(1.0, max(0.0, (ma - da * md) / max(1e-9, aa - da * da)))
            t = min(reach, max(0.0, h * da - md))
            h = min(1.0, max(0.0, (ma + t * da) / aa))
            gx, gy, gz = mx + t * dx - h * ax, my + t * dy - h * ay, mz + t * dz - h * az
            soft = max(2e-3, LAMP_RADIUS_M * t / reach)
            gap = math.sqrt(gx * gx + gy * gy + gz * gz) - ra - h * (rb - ra)
            x = min(1.0, max(0.0, (gap + soft) / (2.0 * soft)))
            key = min(key, x * x * (3.0 - 2.0 * x))
        left[0, i], left[1, i] = ambient, key
