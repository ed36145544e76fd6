"""The world of a rig: which way is up, where the origin is, and the unit."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from codec.arrays import Doubles
from codec.camera import Camera
from codec.rig import rig_centre, rig_up

from .alignment import Similarity

UNKNOWN_DISTANCE = 3.0
"""Distance from the cameras to the origin where nothing gives the unit: that of a small studio in
metres, so that what is meant for metres is of the right order."""

FLOOR_TILT_DEG = 12.0
"""Most by which a floor may be off the cameras' up: rigs are rarely held straighter."""

FLOOR_SHARE, BELOW_SHARE, THICKNESS = 0.1, 0.04, 0.01
"""A floor has at least this share of the points, at most that share lies below it, and it is so
thick, over the distance of the cameras."""

TRIES = 500


def world_of(
    cameras: Sequence[Camera], points: Doubles, scale: float | None
) -> tuple[Similarity, bool]:
    """The similarity into a world with z up, its origin in the middle of what all cameras see; and
    whether its z comes from a floor, and not from how the cameras are held.

    points: (P, 3). scale: metres of a unit; None if that is not known.
    """
    centre = rig_centre(cameras)
    if centre is None:
        centre = np.median(points, axis=0)
    places = np.array([camera.position for camera in cameras])
    distance = float(np.median(np.linalg.norm(places - centre, axis=1)))
    up = rig_up(cameras)
    floor = floor_normal(points, up, distance)
    up = up if floor is None else floor
    # x points away from the first camera, so that equal rigs get equal worlds.
    x = np.cross(centre - places[0], up)
    if np.linalg.norm(x) < 1e-6 * distance:
        x = np.cross(np.eye(3)[int(np.argmin(np.abs(up)))], up)
    x /= np.linalg.norm(x)
    rotation = np.stack([x, np.cross(up, x), up])
    scale = UNKNOWN_DISTANCE / distance if scale is None else scale
    return Similarity(scale, rotation, -scale * rotation @ centre), floor is not None


def floor_normal(points: Doubles, up: Doubles, distance: float) -> Doubles | None:
    """(3,) the upward unit normal of the plane that many points (P, 3) lie in and next to none
    below; None if there is none within FLOOR_TILT_DEG of `up`."""
    if len(points) < 50:
        return None
    rng = np.random.default_rng(0)
    thickness = THICKNESS * distance
    best, most = None, FLOOR_SHARE * len(points)
    for _ in range(TRIES):
        a, b, c = points[rng.choice(len(points), 3, replace=False)]
        normal = np.cross(b - a, c - a)
        length = float(np.linalg.norm(normal))
        if length == 0:
            continue
        normal *= np.sign(normal @ up) / length
        if normal @ up < np.cos(np.radians(FLOOR_TILT_DEG)):
            continue
        heights = (points - a) @ normal
        on = np.abs(heights) < thickness
        if on.sum() > most and (heights < -3 * thickness).mean() < BELOW_SHARE:
            best, most = on, int(on.sum())
    if best is None:
        return None
    plane = points[best]
    normal = np.linalg.svd(plane - plane.mean(axis=0), full_matrices=False)[2][2]
    found: Doubles = normal * np.sign(normal @ up)
    return found


def metres_of_unit(cameras: Sequence[Camera], one: str, other: str, metres: float) -> float:
    """Metres of a unit of the rig, of the distance between two cameras."""
    places = {camera.name: camera.position for camera in cameras}
    return metres / float(np.linalg.norm(places[one] - places[other]))
