"""Where the user of a window has turned, moved and zoomed the camera. Pure."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace

import numpy as np

from codec.arrays import Doubles
from codec.camera import Camera, world_to_camera
from codec.rig import rig_up
from codec.stream.manifest import Manifest
from codec.stream.views import LEAST_ZOOM, MOST_ZOOM, Orbit, scene_centre

TURN_RAD_PER_PX = 0.005
TURN_RAD_PER_STEP = 0.05
ZOOM_PER_STEP = 0.9
"""Distance to the scene's centre after one step of the wheel, as a share of that before."""


@dataclass(slots=True)
class View:
    """The user's change to the path's camera before a frame is drawn."""

    centre: Doubles  # (3,) what the view turns around, metres
    up: Doubles  # (3,) unit
    turn_rad: float = 0.0
    tilt_rad: float = 0.0
    zoom: float = 1.0
    """Distance to the centre as a share of the path's."""
    pan: tuple[float, float] = (0.0, 0.0)
    """To the right and down, in distances to the centre per focal length."""
    flown: Doubles = field(default_factory=lambda: np.zeros(3))
    """(3,) metres, world, from where all that leads."""

    def applied(self, camera: Camera) -> Camera:
        """`camera` as the user wants it."""
        way = Orbit(self.centre, self.up, self.turn_rad, self.tilt_rad, self.zoom, self.pan)
        seen = way.applied(camera)
        place = seen.position + self.flown
        return replace(seen, w2c=world_to_camera(seen.w2c[:3, :3], place))

    def drag_turn(self, right_px: float, down_px: float) -> None:
        """The near side of the scene follows the mouse."""
        self.turn_rad -= right_px * TURN_RAD_PER_PX
        tilt_rad = self.tilt_rad - down_px * TURN_RAD_PER_PX
        self.tilt_rad = min(max(tilt_rad, -math.pi / 2), math.pi / 2)

    def drag_pan(self, right_px: float, down_px: float, focal_px: float) -> None:
        self.pan = (self.pan[0] + right_px / focal_px, self.pan[1] + down_px / focal_px)

    def scroll(self, right_steps: float, up_steps: float) -> None:
        """A wheel comes nearer; two fingers on a touchpad also turn."""
        self.zoom = min(max(self.zoom * ZOOM_PER_STEP**up_steps, LEAST_ZOOM), MOST_ZOOM)
        self.turn_rad -= right_steps * TURN_RAD_PER_STEP

    def fly(self, camera: Camera, right: float, down: float, forward: float) -> None:
        """Moves on from `camera`, the one that `applied` gave last, in distances to the centre."""
        distance_m = float(np.linalg.norm(camera.position - self.centre))
        # The rows of the rotation point to the right, down and forward.
        along = np.array([right, down, forward]) @ camera.w2c[:3, :3]
        self.flown = self.flown + distance_m * along

    def reset(self) -> None:
        self.turn_rad = self.tilt_rad = 0.0
        self.zoom, self.pan, self.flown = 1.0, (0.0, 0.0), np.zeros(3)


def view_of(manifest: Manifest) -> View:
    return View(scene_centre(manifest), rig_up(manifest.cameras))
