"""The objects of the synthetic scene: the room, its furniture, the lamp, the cameras.

The world's y points down and the floor is y = 0, so a height of h metres is y = -h.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from codec.camera import Camera
from codec.pose import look_at

from .paint import (
    ARCHES,
    BACK,
    BLOBS,
    BLOCKS,
    BOOKS,
    CRATE,
    FRONT,
    LAMP,
    LEAF,
    LEFT,
    PLAIN,
    RIGHT,
    SUNSET,
    WINDOW,
    WOOD,
    linear,
)
from .solid import Boxes, Parts, Table, Vector

ROOM = np.array([3.75, 3.1])
"""Half the width of the square room, and its height, metres."""

LAMP_AT = np.array([0.5, -2.72, -0.45])
"""The middle of the lamp, metres."""

CAMERA_RADIUS_M = 3.2
"""Horizontal distance of the cameras from the middle of the room."""
CAMERA_HEIGHTS_M = (1.05, 2.05)
"""Taken in turn along the arc."""
CAMERA_TARGET = np.array([0.0, -1.0, 0.15])
"""The point that every camera looks at, metres."""
UP = np.array([0.0, -1.0, 0.0])
FIELD_OF_VIEW_RAD = np.radians(74.0)
"""Horizontal."""


class PartList:
    """Collects parts one by one."""

    def __init__(self) -> None:
        self._rows: list[tuple[Table, Table, int, tuple[float, ...]]] = []

    def add(
        self,
        pattern: int,
        colour: str,
        first: npt.ArrayLike,
        first_radius_m: float,
        second: npt.ArrayLike | None = None,
        second_radius_m: float | None = None,
        axes: Table | None = None,
        second_colour: str | None = None,
    ) -> None:
        """Adds a round cone, or a sphere when there is no second centre.

        axes: (3, 3) unit vectors right, up and forward of the pattern; by default, forward is -z.
        """
        a = np.asarray(first, np.float64)
        b = a if second is None else np.asarray(second, np.float64)
        rb = first_radius_m if second_radius_m is None else second_radius_m
        if axes is None:
            axes = np.array([[1.0, 0, 0], [0, -1, 0], [0, 0, -1]])
        colours = linear(colour) + linear(second_colour or colour)
        around = float(np.linalg.norm(b - a)) / 2 + max(first_radius_m, rb)
        cone = np.array([*a, first_radius_m, *b, rb, *((a + b) / 2), around])
        self._rows.append((cone, axes.ravel(), pattern, colours))

    def __len__(self) -> int:
        return len(self._rows)

    def parts(self) -> Parts:
        cones, axes, patterns, colours = zip(*self._rows, strict=True)
        return Parts(
            np.array(cones), np.array(axes), np.array(patterns, np.int64), np.array(colours)
        )


def furniture() -> Boxes:
    """The boxes of the room: shelf, sofa, crates, cupboards, the plant's pot."""
    rows: list[tuple[list[float], int, tuple[float, ...]]] = []

    def add(
        pattern: int,
        colour: str,
        centre: Vector,
        size: Vector,
        turn_rad: float = 0.0,
        second_colour: str | None = None,
    ) -> None:
        x, height, z = centre
        half = [s / 2 for s in size]
        place = [x, -height, z, *half, float(np.cos(turn_rad)), float(np.sin(turn_rad))]
        rows.append((place, pattern, linear(colour) + linear(second_colour or colour)))

    add(BOOKS, "7a5132", (2.1, 1.0, 3.5), (1.5, 2.0, 0.42))
    # The sofa: seat, back, two arms, cushions.
    add(PLAIN, "d9694f", (-0.75, 0.24, 2.95), (2.1, 0.4, 0.85))
    add(PLAIN, "c75b44", (-0.75, 0.52, 3.38), (2.1, 0.86, 0.24))
    add(PLAIN, "c75b44", (-1.9, 0.34, 2.97), (0.24, 0.62, 0.9))
    add(PLAIN, "c75b44", (0.4, 0.34, 2.97), (0.24, 0.62, 0.9))
    add(PLAIN, "f2b632", (-1.45, 0.62, 3.12), (0.42, 0.36, 0.16), 0.25)
    add(PLAIN, "f1e6d2", (-0.05, 0.6, 3.13), (0.4, 0.34, 0.16), -0.3)
    # Crates in the right corner, the upper one turned.
    add(CRATE, "cf9f63", (3.05, 0.33, 2.05), (0.66, 0.66, 0.66), 0.12, "9c6a38")
    add(CRATE, "5f9ea0", (3.08, 0.9, 2.08), (0.48, 0.48, 0.48), 0.6, "f0e4cf")
    # A low cupboard on the left, with the plant's pot beside it.
    add(WOOD, "a8744a", (-3.45, 0.4, 1.9), (0.55, 0.8, 1.2))
    add(PLAIN, "f0e8da", (-3.12, 0.22, 2.95), (0.42, 0.44, 0.42), 0.4)
    # A cupboard behind the cameras.
    add(WOOD, "8d5f3a", (1.3, 0.35, -3.52), (1.6, 0.7, 0.42))
    return Boxes(
        np.array([row[0] for row in rows]),
        np.array([row[1] for row in rows], np.int64),
        np.array([row[2] for row in rows]),
    )


def fixtures(seed: int) -> Parts:
    """The parts that do not move: the lamp and its cord, the plant, things on the cupboards."""
    parts = PartList()
    x, y, z = LAMP_AT
    parts.add(LAMP, "ffffff", (x, y, z), 0.17)
    parts.add(PLAIN, "23262e", (x, y - 0.17, z), 0.018, (x, -ROOM[1], z), 0.018)
    parts.add(PLAIN, "23262e", (x, y - 0.15, z), 0.07, (x, y - 0.22, z), 0.03)
    rng = np.random.default_rng(seed)
    for _ in range(15):
        around, tilt = rng.uniform(0, 2 * np.pi), rng.uniform(0.15, 0.95)
        reach = rng.uniform(0.45, 0.95)
        root = np.array([-3.12, -0.44, 2.95])
        out = np.array(
            [np.sin(tilt) * np.cos(around), -np.cos(tilt), np.sin(tilt) * np.sin(around)]
        )
        tip = np.clip(root + reach * out, -3.6, 3.6)
        middle = root + 0.5 * (tip - root) + (0, -0.05, 0)
        parts.add(LEAF, "3f7d4a", middle, 0.1, tip, 0.03, None, "7fb069")
    parts.add(PLAIN, "2c5fa8", (-3.42, -0.94, 1.6), 0.13, (-3.42, -1.13, 1.6), 0.07)
    parts.add(PLAIN, "f2b632", (-3.42, -0.92, 2.12), 0.12)
    parts.add(PLAIN, "e58fa0", (1.0, -0.85, -3.5), 0.14, (1.0, -1.1, -3.5), 0.05)
    return parts.parts()


def wall_pictures() -> Table:
    """(K, 6) what hangs on the walls: the face of the room, the middle's place to the right along
    the wall and its height above the floor, the picture's width and height, its kind; metres."""
    return np.array(
        [
            (BACK, -1.55, 1.85, 1.15, 1.3, SUNSET),
            (BACK, 0.15, 1.85, 1.15, 1.3, BLOBS),
            (LEFT, -0.6, 1.85, 1.9, 1.35, WINDOW),
            (LEFT, 2.0, 1.85, 0.9, 1.1, ARCHES),
            (RIGHT, 0.4, 1.85, 1.0, 1.3, BLOCKS),
            (RIGHT, -1.9, 1.95, 0.9, 1.1, BLOBS),
            (FRONT, -1.6, 1.85, 1.2, 1.2, ARCHES),
            (FRONT, 0.9, 1.85, 1.9, 1.35, WINDOW),
        ],
        np.float64,
    )


def camera_rig(num_cameras: int, width_px: int, height_px: int, arc_rad: float) -> list[Camera]:
    """Cameras cam00, cam01, ... evenly on an arc around the room's middle, all looking inward."""
    focal = width_px / 2 / np.tan(FIELD_OF_VIEW_RAD / 2)
    cameras = []
    for i in range(num_cameras):
        angle = arc_rad * (i / (num_cameras - 1) - 0.5) if num_cameras > 1 else 0.0
        position = CAMERA_RADIUS_M * np.array([-np.sin(angle), 0.0, -np.cos(angle)])
        position[1] = -CAMERA_HEIGHTS_M[i % len(CAMERA_HEIGHTS_M)]
        cameras.append(
            Camera(
                name=f"cam{i:02d}",
                width_px=width_px,
                height_px=height_px,
                fx_px=float(focal),
                fy_px=float(focal),
                cx_px=width_px / 2,
                cy_px=height_px / 2,
                w2c=look_at(position, CAMERA_TARGET, UP),
            )
        )
    return cameras


def held_out_cameras(cameras: Sequence[Camera], held_out: int) -> list[str]:
    """Names of `held_out` cameras, evenly between the others and never at an end of the arc."""
    places = np.linspace(0, len(cameras) - 1, held_out + 2)[1:-1]
    return [cameras[round(float(place))].name for place in places]
