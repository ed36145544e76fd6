"""The sliding window's bookkeeping, Algorithm 1 as invariants, and the choice of the camera for an
iteration."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from trainer.fit.cameradraws import CameraDraws
from trainer.fit.lifespans import Lifespans

sizes = st.tuples(st.integers(1, 6), st.integers(1, 5))  # swin_size, slice_size


def after_genesis(swin_size: int, slice_size: int, seed: int = 0) -> Lifespans:
    lifespans = Lifespans(swin_size * slice_size, swin_size)
    ranking = np.random.default_rng(seed).permutation(lifespans.num_gs)
    order = lifespans.deal(ranking)
    lifespans.stagger()
    # The first of the ranking live longest.
    longest_first = np.argsort(-lifespans.expires, kind="stable")
    assert order[longest_first].tolist() == ranking.tolist()
    return lifespans


@given(sizes)
def test_genesis_shows_everything_and_matures_one_slice_for_each_expiry(
    size: tuple[int, int],
) -> None:
    swin_size, slice_size = size
    fresh = Lifespans(swin_size * slice_size, swin_size)
    for frame in range(swin_size):
        assert len(fresh.active_rows(frame)) == fresh.num_gs
    lifespans = after_genesis(swin_size, slice_size)
    assert lifespans.due(1) == list(range(1 - swin_size, 1))


@given(sizes, st.integers(1, 12))
def test_one_slice_matures_per_frame_and_every_frame_has_num_gs(
    size: tuple[int, int], total: int
) -> None:
    swin_size, slice_size = size
    lifespans = after_genesis(swin_size, slice_size)
    written: list[int] = []
    for first_frame in range(1, total + 1):
        due = lifespans.due(first_frame)
        if first_frame > 1:
            assert len(due) == 1
        for birth in due:
            rows = lifespans.mature(birth)
            assert rows.start // slice_size == birth % swin_size
            written.append(birth)
        # Frames of the window: all rows trainable or matured, each slot at most once.
        for frame in range(first_frame, first_frame + swin_size):
            rows_now = lifespans.active_rows(frame)
            assert len(rows_now) == lifespans.num_gs
            assert len(set(rows_now % lifespans.num_gs)) == lifespans.num_gs
        # In the window's first frame one slice can still change, in its last frame all can.
        trainable = lifespans.active_rows(first_frame) < lifespans.num_gs
        assert trainable.sum() == slice_size
        last = lifespans.active_rows(first_frame + swin_size - 1)
        assert (last < lifespans.num_gs).all()
    assert written == list(range(1 - swin_size, total))


def test_ages_count_the_windows_a_generation_was_trained_for() -> None:
    lifespans = after_genesis(4, 1)
    for birth in lifespans.due(1):
        lifespans.mature(birth)
    assert sorted(lifespans.ages(1)) == [0, 1, 2, 3]
    assert lifespans.ages(1)[lifespans.births == 1] == 3
    assert lifespans.ages(1)[lifespans.births == 4] == 0
    # A Gaussian that starts late has been trained for as long as it has shown.
    lifespans.starts[lifespans.births == 1] = 3
    assert lifespans.ages(1)[lifespans.births == 1] == 1


def test_a_delayed_start_hides_a_slot_between_birth_and_start() -> None:
    lifespans = after_genesis(3, 2)
    for birth in lifespans.due(1):
        lifespans.mature(birth)
    slot = int(np.flatnonzero(lifespans.births == 1)[0])
    lifespans.starts[slot] = 3
    for frame, shown in ((1, False), (2, False), (3, True)):
        assert (slot in lifespans.active_rows(frame) % lifespans.num_gs) is shown
    rows = lifespans.mature(1)
    assert lifespans.matured_starts[slot] == 3
    assert lifespans.starts[slot] == 4  # the next generation starts on time again
    assert rows.start <= slot < rows.stop


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


@settings(max_examples=25)
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
