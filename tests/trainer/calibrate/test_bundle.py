"""The adjustment of a rig to what is seen, and to what is known of lenses before."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from codec.arrays import Doubles
from tests.trainer.calibrate.test_rigs import FOCAL, HEIGHT, WIDTH, arc
from trainer.calibrate import bundle
from trainer.calibrate.bundle import Bundle, adjusted
from trainer.calibrate.solution import align, angles_deg

NUM_CAMERAS = 8


def filmed(count: int, noise_px: float) -> tuple[Bundle, Bundle]:
    """The true bundle, and a first guess with what its cameras see."""
    rng = np.random.default_rng(0)
    cameras = np.repeat(np.arange(NUM_CAMERAS), count)
    points = np.tile(np.arange(count), NUM_CAMERAS)
    near = np.abs(rng.integers(0, NUM_CAMERAS, count)[points] - cameras) <= 1
    lenses = np.array([FOCAL, WIDTH / 2, HEIGHT / 2, -0.05]) + np.zeros((NUM_CAMERAS, 1))
    lenses += rng.uniform(-1, 1, lenses.shape) * (0.01 * FOCAL, 0.01 * WIDTH, 0.01 * WIDTH, 0.01)
    xyz, none = rng.uniform(-1.2, 1.2, (count, 3)), np.zeros((near.sum(), 2))
    true = Bundle(lenses, arc(), xyz, cameras[near], points[near], points[near], none)
    seen = true.misses_px() + rng.normal(0, noise_px, none.shape)
    poses = arc()
    poses[:, :, :3] = (
        Rotation.from_rotvec(rng.normal(0, 0.01, (8, 3))).as_matrix() @ arc()[:, :, :3]
    )
    guess = lenses.mean(axis=0) + np.zeros((NUM_CAMERAS, 1))
    start = xyz + rng.normal(0, 0.05, xyz.shape)
    return true, Bundle(guess, poses, start, true.cameras, true.seen, true.keypoints, seen)


def turned_deg(found: Bundle, true: Bundle) -> Doubles:
    poses = align(found.poses, true.poses).poses(found.poses)
    return angles_deg(poses[:, :, :3], true.poses[:, :, :3])


def test_slopes_are_those_of_the_errors() -> None:
    _, at = filmed(20, 0.3)
    of_cameras, of_points = bundle._slopes(at)
    step = 1e-6
    for i in range(bundle.POSE + bundle.LENS):
        moves = np.zeros((NUM_CAMERAS, bundle.POSE + bundle.LENS))
        moves[:, i] = step
        ahead, behind = (at.moved(way * moves, np.zeros(3)).misses_px() for way in (1, -1))
        slopes = (ahead - behind) / (2 * step)
        np.testing.assert_allclose(of_cameras[:, :, i], slopes, rtol=1e-4, atol=1e-3)
    for i in range(3):
        moves = step * np.eye(3)[i]
        none = np.zeros((NUM_CAMERAS, bundle.POSE + bundle.LENS))
        ahead, behind = (at.moved(none, way * moves).misses_px() for way in (1, -1))
        slopes = (ahead - behind) / (2 * step)
        np.testing.assert_allclose(of_points[:, :, i], slopes, rtol=1e-4, atol=1e-3)


def test_few_points_do_not_turn_cameras_whose_lenses_are_alike(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Where lenses are free, the turns are those of the noise."""
    true, guess = filmed(150, 0.4)
    given = [0] * NUM_CAMERAS, [(WIDTH, HEIGHT)] * NUM_CAMERAS, 1.0
    found = adjusted(guess, *given)
    assert np.median(np.abs(found.lenses[:, 0] / true.lenses[:, 0] - 1)) < 0.005
    for name in ("CENTRE_SPREAD", "FOCAL_SPREAD", "RADIAL_SPREAD"):
        monkeypatch.setattr(bundle, name, 1.0)
    free = adjusted(guess, *given)
    known_deg, free_deg = (np.median(turned_deg(each, true)) for each in (found, free))
    assert known_deg < 0.6
    assert known_deg < free_deg / 2


def test_what_lies_off_is_left_out() -> None:
    true, guess = filmed(400, 0.2)
    guess.xy_px[::20] += 30.0
    found = adjusted(guess, [0] * NUM_CAMERAS, [(WIDTH, HEIGHT)] * NUM_CAMERAS, 1.0)
    assert 0.85 * len(guess.seen) < len(found.seen) < 0.96 * len(guess.seen)
    assert np.linalg.norm(found.misses_px(), axis=1).max() < 2
    assert turned_deg(found, true).max() < 0.6
    assert np.bincount(found.seen).min() >= 2
