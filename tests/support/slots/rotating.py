"""A rigid figure that turns about the vertical axis: a sequence whose every Gaussian moves."""

from __future__ import annotations

import math

import numpy as np

from codec.camera import rotation_about
from codec.splats import Splats
from tests.support.trained_like import trained_like_splats

REACH_M = 2.0
"""Gaussians farther than this from the middle belong to the room, not to the figure."""


def figure(count: int, seed: int = 0) -> Splats:
    """`count` Gaussians on a figure of balls."""
    splats = trained_like_splats(2 * count + 100, seed)
    near = np.flatnonzero(abs(splats.means).max(axis=1) < REACH_M)
    assert len(near) >= count
    return splats.take(near[:count])


def turned(splats: Splats, angle_rad: float) -> Splats:
    """`splats` turned about the y axis."""
    turn = rotation_about(np.array([0.0, 1.0, 0.0]), angle_rad)
    cos, sin = math.cos(angle_rad / 2), math.sin(angle_rad / 2)
    w, x, y, z = splats.quats.astype(np.float64).T
    quats = np.stack(
        [cos * w - sin * y, cos * x + sin * z, cos * y + sin * w, cos * z - sin * x], axis=1
    )
    return Splats(
        (splats.means @ turn.T).astype(np.float32),
        splats.log_scales,
        quats.astype(np.float32),
        splats.logit_opacities,
        splats.sh,
    )
