"""Surfaces of the synthetic scene as flat Gaussians: where they lie, their light, how they look."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from codec.arrays import Doubles, Floats, Ints
from codec.kernel import kernel, prange
from codec.splats import SH_C0, Splats

from .paint import Flat, Solid, even

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
