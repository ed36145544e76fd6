"""Depth pictures: planes have the correct depth, independent of their colours."""

from __future__ import annotations

import numpy as np
import pytest

from codec.camera import Camera
from codec.splats import Splats
from player.render.cpu import render_depth

NEAR_M = 0.5


def wall(depth_m: float, opacity: float, half: int = 12) -> Splats:
    """Gaussians side by side in a plane across the view, at `depth_m` in front of the camera."""
    steps = np.linspace(-2 * depth_m, 2 * depth_m, 2 * half)
    x, y = np.meshgrid(steps, steps)
    count = x.size
    means = np.stack([x.ravel(), y.ravel(), np.full(count, depth_m)], axis=1)
    return Splats(
        means.astype(np.float32),
        np.full((count, 3), np.log(0.25 * depth_m), np.float32),
        np.tile(np.array([1, 0, 0, 0], np.float32), (count, 1)),
        np.full(count, np.log(opacity / (1 - opacity)), np.float32),
        np.random.default_rng(0).normal(0, 2, (count, 4, 3)).astype(np.float32),
    )


CAMERA = Camera("c", 48, 32, 40, 40, 24, 16, np.eye(4))


@pytest.mark.parametrize("depth_m", [0.7, 3.0, 400.0])
def test_a_wall_has_its_depth_along_the_axis_everywhere(depth_m: float) -> None:
    depth = render_depth(wall(depth_m, 0.98), CAMERA, NEAR_M)
    assert depth.shape == (32, 48)
    assert depth.dtype == np.float32
    np.testing.assert_allclose(depth, depth_m, rtol=1e-4)


def test_the_front_wall_hides_the_other_one() -> None:
    both = Splats.concatenate([wall(5.0, 0.98), wall(2.0, 0.98)])
    np.testing.assert_allclose(render_depth(both, CAMERA, NEAR_M), 2.0, rtol=0.02)


def test_a_pose_moves_depths_and_nothing_has_none() -> None:
    w2c = np.eye(4)
    w2c[2, 3] = 1.5  # moves the camera back
    behind = Camera("c", 48, 32, 40, 40, 24, 16, w2c)
    np.testing.assert_allclose(render_depth(wall(3.0, 0.98), behind, NEAR_M), 4.5, rtol=1e-4)
    assert np.isnan(render_depth(wall(0.4, 0.98), CAMERA, NEAR_M)).all()  # before the near plane
    assert np.isnan(render_depth(wall(3.0, 0.02), CAMERA, NEAR_M)).all()  # nearly transparent
