"""The choice of the camera for an iteration."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from trainer.fit.cameradraws import CameraDraws


def drawn(draws: CameraDraws, count: int, seed: int = 0, error_share: float = 0.5) -> list[int]:
    rng = np.random.default_rng(seed)
    return [draws.draw(rng, error_share) for _ in range(count)]


@given(st.integers(1, 40), st.integers(1, 30), st.integers(0, 1 << 32))
def test_equal_cameras_are_drawn_equally_often(cameras: int, rounds: int, seed: int) -> None:
    counts = np.bincount(drawn(CameraDraws(cameras), cameras * rounds, seed))
    assert counts.tolist() == [rounds] * cameras


def test_their_order_is_a_matter_of_chance() -> None:
    orders = {tuple(drawn(CameraDraws(5), 5, seed)) for seed in range(200)}
    assert len(orders) > 60  # of 120


@given(st.lists(st.floats(0.01, 1), min_size=2, max_size=12), st.floats(0, 1), st.integers(0, 99))
def test_no_camera_falls_behind_its_share(
    losses: list[float], error_share: float, seed: int
) -> None:
    draws = CameraDraws(len(losses))
    for camera, loss in enumerate(losses):
        draws.note(camera, loss)
    even = (1 - error_share) / len(losses)
    shares = even + error_share * np.array(losses) / sum(losses)
    assert draws.shares(error_share) == pytest.approx(shares)
    counts = np.zeros(len(losses))
    for done, camera in enumerate(drawn(draws, 300, seed, error_share), 1):
        counts[camera] += 1
        assert (np.abs(counts - done * shares) < 2 + len(losses) / 2).all()


def test_who_was_not_seen_counts_as_the_others_do() -> None:
    draws = CameraDraws(3)
    draws.note(0, 0.1)
    draws.note(1, 0.3)
    assert draws.shares(1) == pytest.approx([1 / 6, 1 / 2, 1 / 3])


def test_it_goes_on_from_its_state() -> None:
    first = CameraDraws(6)
    for camera in range(6):
        first.note(camera, 0.1 + camera)
    drawn(first, 17)
    second = CameraDraws(6)
    for name, array in second.state().items():
        array[...] = first.state()[name]
    assert drawn(second, 30, 1) == drawn(first, 30, 1)
