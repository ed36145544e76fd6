"""Whether the training cameras stand so far apart that what they see cannot be matched."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from codec.camera import Camera
from trainer.capture.capture import Capture
from trainer.capture.depths import rig_centre

FAR_APART_DEG = 45.0
"""Surfaces turn away, and are hidden, between views this far apart. Rigs that train well have about
26 degrees (basketball, 27 cameras) to 32 (8 cameras on an arc of 200); 4 on an arc of 160 have 75,
and their Gaussians are smears that fit each camera alone."""


def neighbour_angle_deg(cameras: Sequence[Camera]) -> float | None:
    """The angle to a camera's second neighbour, seen from what the rig looks at: a point needs
    three views to be sure of. The median over the cameras; None with fewer than three, and for a
    rig that looks one way, which has no such point."""
    centre = rig_centre(cameras)
    if centre is None or len(cameras) < 3:
        return None
    directions = np.array([camera.position - centre for camera in cameras])
    lengths = np.linalg.norm(directions, axis=1, keepdims=True)
    directions /= np.maximum(lengths, 1e-12)
    cosines = np.sort(np.clip(directions @ directions.T, -1, 1), axis=1)
    return float(np.degrees(np.median(np.arccos(cosines[:, -3]))))


def apart_warning(capture: Capture) -> str | None:
    """A line for who is about to train for hours; None where nothing is wrong."""
    cameras = [capture.cameras[i].camera for i in capture.training]
    angle_deg = neighbour_angle_deg(cameras)
    if angle_deg is None or angle_deg <= FAR_APART_DEG:
        return None
    return (
        f"{capture.root}: the {len(cameras)} training cameras stand far apart, {angle_deg:.0f} "
        f"degrees to the second neighbour; above {FAR_APART_DEG:.0f} other views are smeared. "
        "Film with more cameras, closer together, or hold fewer out"
    )
