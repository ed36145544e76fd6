"""Depth of the nearest objects, from places that cameras see."""

from __future__ import annotations

import numpy as np
import pytest

from codec.camera import Camera
from trainer.seed.nearest import MIN_IN_VIEW, MIN_STRAYS, nearest_seen, share_nearer


def camera(forward: float = 1.0) -> Camera:
    """A camera at the origin that looks along z, or in the opposite direction."""
    pose = np.diag([1.0, forward, forward, 1.0])
    return Camera("c", 64, 64, 32.0, 32.0, 32.0, 32.0, pose)


def places(depths: np.ndarray) -> np.ndarray:
    """Places on the axis of the camera."""
    return np.stack([0 * depths, 0 * depths, depths], axis=1)


def test_a_few_strays_do_not_count() -> None:
    depths = np.linspace(2.0, 9.0, 200)
    assert nearest_seen([camera()], places(depths)) == pytest.approx(depths[MIN_STRAYS])
    strayed = np.concatenate([np.full(MIN_STRAYS, 0.1), depths])
    assert nearest_seen([camera()], places(strayed)) == pytest.approx(2.0)
    assert nearest_seen([camera()], places(np.append(strayed, 0.2))) == pytest.approx(0.2)
    many = np.concatenate([np.full(50, 0.1), np.linspace(2.0, 9.0, 10_000)])
    assert nearest_seen([camera()], places(many)) == pytest.approx(2.0, rel=0.01)


def test_what_is_out_of_view_does_not_count() -> None:
    behind = places(np.linspace(0.5, 3.0, 500))
    assert nearest_seen([camera(-1.0)], behind) is None
    beside = behind + (1.1, 0.0, 0.0) * behind[:, 2:]
    assert nearest_seen([camera()], beside) is None
    assert nearest_seen([camera(-1.0), camera()], behind) == pytest.approx(0.5, rel=0.1)


def test_too_few_places_tell_nothing() -> None:
    few = places(np.linspace(1.0, 2.0, MIN_IN_VIEW - 1))
    assert nearest_seen([camera()], few) is None
    assert nearest_seen([], few) is None
    assert share_nearer(camera(), few, 1.5) == 0
    enough = places(np.linspace(1.0, 2.0, 101))
    assert share_nearer(camera(), enough, 1.5) == pytest.approx(50 / 101)
