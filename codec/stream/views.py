"""Views of a stream that its cameras do not have: turned around the middle of the scene, and as the
text that the browser player's button for links writes."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from codec.arrays import Doubles
from codec.camera import Camera, rotation_about, rotation_of, world_to_camera
from codec.errors import InvalidError
from codec.rig import closest_point, rig_up

from .manifest import Manifest

LEAST_SPREAD = 1e-3
"""See `closest_point`. Cameras whose axes spread less (1.8 degrees) look the same way: where these
cross is chance, and the middle of the scene is the better centre."""

LEAST_ZOOM, MOST_ZOOM = 0.02, 50.0
"""Limits of the distance to the centre, as a share of that at the start."""

MOST_IN_TEXT = 1e6
"""Largest number of a view's text: larger ones would leave floats no digits for the scene."""


def turned(camera: Camera, centre: Doubles, axis: Doubles, angle_rad: float) -> Camera:
    """`camera` carried around the line through `centre` along the unit vector `axis`."""
    turn = rotation_about(axis, angle_rad)
    position = centre + turn @ (camera.position - centre)
    return replace(camera, w2c=world_to_camera(camera.w2c[:3, :3] @ turn.T, position))


def scene_centre(manifest: Manifest) -> Doubles:
    """(3,) what an orbit turns around: where the capture's cameras look, or the bounds' middle."""
    lower, upper = np.array(manifest.bounds, np.float64)
    point = closest_point(manifest.cameras, LEAST_SPREAD)
    if point is not None and (lower <= point).all() and (point <= upper).all():
        return point
    middle: Doubles = (lower + upper) / 2
    return middle


@dataclass(frozen=True, slots=True)
class Orbit:
    """A way around a centre, from any camera."""

    centre: Doubles  # (3,) metres
    up: Doubles  # (3,) unit
    turn_rad: float = 0.0
    tilt_rad: float = 0.0
    zoom: float = 1.0
    """Distance to the centre as a share of the camera's."""
    pan: tuple[float, float] = (0.0, 0.0)
    """To the right and down, in distances to the centre per focal length."""

    def applied(self, camera: Camera) -> Camera:
        """Where it leads from `camera`."""
        seen = turned(camera, self.centre, self.up, self.turn_rad)
        seen = turned(seen, self.centre, seen.right, self.tilt_rad)
        away = seen.position - self.centre
        distance_m = float(np.linalg.norm(away)) * self.zoom
        place = self.centre + away * self.zoom
        place = place - distance_m * (self.pan[0] * seen.right + self.pan[1] * seen.down)
        return replace(seen, w2c=world_to_camera(seen.w2c[:3, :3], place))


def view_from_text(text: str, manifest: Manifest) -> Camera:
    """The camera of the `text` that a link's `view` holds, with the lens of the stream's first
    view. Raises InvalidError.

    Five numbers lead from that view: turn, tilt, zoom, and the way to the right and down. Ten are
    the pose itself: position, quaternion wxyz, and the point that it turns around (docs/EMBED.md).
    """
    start = manifest.camera()
    try:
        numbers = [float(one) for one in text.split(",")]
    except ValueError:
        numbers = []
    if not all(abs(one) <= MOST_IN_TEXT for one in numbers):
        numbers = []
    if len(numbers) == 5:
        turn_rad, tilt_rad, zoom, *pan = numbers
        tilt_rad = min(max(tilt_rad, -math.pi / 2), math.pi / 2)
        zoom = min(max(zoom, LEAST_ZOOM), MOST_ZOOM)
        centre, up = scene_centre(manifest), rig_up(manifest.cameras)
        return Orbit(centre, up, turn_rad, tilt_rad, zoom, (pan[0], pan[1])).applied(start)
    quat = np.array(numbers[3:7])
    length = float(np.linalg.norm(quat))
    if len(numbers) == 10 and length > 0.5:
        rotation = rotation_of(quat / length).T
        return replace(start, w2c=world_to_camera(rotation, np.array(numbers[:3])))
    raise InvalidError(
        f"view {text[:80]!r} is not five or ten numbers with commas, as the link button of the "
        "browser player writes them (view=...)"
    )
