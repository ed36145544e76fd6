"""The window's bookkeeping, Algorithm 1 as invariants; choice of cameras; relocation."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from codec.camera import Camera
from player.render.project import ALPHA_MAX
from trainer.fit.generations import Lifespans
from trainer.fit.mcmc import MAX_COPIES, relocate, split_opacity_and_scale
from trainer.fit.trainer import CameraDraws
from trainer.step.optimiser import CameraSpread, bound_scales
from trainer.step.raster import Parameters, View, render

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


@given(sizes, st.integers(1, 12))
def test_a_slice_matures_per_frame_and_each_has_num_gs(size: tuple[int, int], total: int) -> None:
    swin_size, slice_size = size
    fresh = Lifespans(swin_size * slice_size, swin_size)
    assert all(len(fresh.active_rows(frame)) == fresh.num_gs for frame in range(swin_size))
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


@settings(max_examples=25)
@given(st.lists(st.floats(0.01, 1), min_size=2, max_size=12), st.floats(0, 1), st.integers(0, 99))
def test_each_camera_keeps_its_share(losses: list[float], error_share: float, seed: int) -> None:
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


def test_their_order_is_chance_and_who_was_not_seen_counts_as_the_others_do() -> None:
    orders = {tuple(drawn(CameraDraws(5), 5, seed)) for seed in range(200)}
    assert len(orders) > 60  # of 120
    draws = CameraDraws(3)
    draws.note(0, 0.1)
    draws.note(1, 0.3)
    assert draws.shares(1) == pytest.approx([1 / 6, 1 / 2, 1 / 3])


@given(st.floats(0.05, 0.95), st.integers(1, MAX_COPIES))
def test_copies_keep_the_integral_of_a_line_through_them(opacity: float, copies: int) -> None:
    """By quadrature: the blended opacity of the copies, integrated along a line through their
    common centre, is that of the old Gaussian."""
    new, factor = split_opacity_and_scale(np.array([opacity]), np.array([copies]), 1e-9)
    assert 1 - (1 - new[0]) ** copies == pytest.approx(opacity, rel=1e-6)
    assert 0 < factor[0] <= 1 + 1e-6
    x = np.linspace(-12, 12, 20001)
    before = opacity * np.exp(-0.5 * x**2)
    after = 1 - (1 - new[0] * np.exp(-0.5 * (x / factor[0]) ** 2)) ** copies
    assert after.sum() == pytest.approx(before.sum(), rel=1e-4)


def lone_gaussian(rows: int, opacity: float) -> Parameters:
    values = Parameters.zeros(rows, 0)
    values.quats[:, 0] = 1
    values.log_scales[:] = np.log(0.3)
    values.logit_opacities[:] = np.log(opacity / (1 - opacity))
    values.means[:] = (0, 0, 3)
    values.sh[:, 0] = 1.0
    return values


def test_relocation_keeps_the_rendered_picture() -> None:
    camera = Camera("c", 64, 64, 60.0, 60.0, 32.0, 32.0, np.eye(4))
    view = View.prepare(camera, 0.2)
    for opacity in (0.3, 0.7, 0.95):
        values = lone_gaussian(4, opacity)
        values.means[1:] = (50, 50, 3)  # the dead ones, elsewhere
        values.logit_opacities[1:] = -9
        rows = np.arange(4, dtype=np.int32)
        before = render(values, rows, view).picture
        targets = relocate(values, np.arange(1, 4), np.array([0]), 0.005, np.random.default_rng(0))
        assert (targets == 0).all()
        after = render(values, rows, view).picture
        assert opacity < ALPHA_MAX
        # The formula keeps the integral along a line, not each pixel: a few per cent at the rim.
        assert np.abs(after - before).max() < 0.11 * before.max()
        through_centre = before[0, 31].sum()
        assert after[0, 31].sum() == pytest.approx(through_centre, rel=0.03)


def test_relocation_takes_the_opaque_more_often_and_touches_no_one_else() -> None:
    values = lone_gaussian(300, 0.5)
    values.logit_opacities[:100] = -9  # dead
    values.logit_opacities[100:200] = np.log(0.1 / 0.9)
    values.logit_opacities[200:] = np.log(0.9 / 0.1)
    before, none, rng = values.log_scales.copy(), np.zeros(0, np.int64), np.random.default_rng(1)
    # Without dead or living it does nothing.
    assert len(relocate(values, none, np.arange(4), 0.005, rng)) == 0
    assert len(relocate(values, np.arange(4), none, 0.005, rng)) == 0
    assert (values.log_scales == before).all()
    targets = relocate(values, np.arange(100), np.arange(100, 300), 0.005, rng)
    assert 80 < (targets >= 200).sum() <= 100  # expected 90
    spared = np.setdiff1d(np.arange(100, 300), targets)
    assert (values.log_scales[spared] == before[spared]).all()
    for dead, target in enumerate(targets):
        assert values.logit_opacities[dead] == values.logit_opacities[target]
        assert (values.log_scales[dead] == values.log_scales[target]).all()


def camera_at(x: float, y: float, z: float) -> Camera:
    pose = np.eye(4)
    pose[:3, 3] = (-x, -y, -z)
    return Camera("c", 64, 64, 60.0, 60.0, 32.0, 32.0, pose)


def test_distances_are_means_over_the_cameras() -> None:
    rng = np.random.default_rng(5)
    places, means = rng.normal(size=(7, 3)), rng.normal(size=(20, 3)).astype(np.float32)
    spread = CameraSpread.of([camera_at(*place) for place in places])
    apart = means[:, None] - places
    expected = np.sqrt((apart**2).sum(axis=2).mean(axis=1))
    np.testing.assert_allclose(spread.distances_m(means), expected, rtol=1e-6)


def test_scales_are_bounded_where_they_are_asked_to_be_and_nowhere_else() -> None:
    values = lone_gaussian(4, 0.5)
    values.means[:] = [(0, 0, 0), (0, 0, 30), (0, 0, 0), (0, 0, 0)]
    values.log_scales[:] = np.log([(9, 0.1, 1), (9, 9, 0.1), (9, 9, 9), (0.1, 0.1, 0.1)])
    spread = CameraSpread.of([camera_at(3, 0, 0), camera_at(-3, 0, 0)])
    before = values.log_scales.copy()
    bound_scales(values, np.array([0, 1, 3], np.int32), spread, 0.2)
    scales = np.exp(values.log_scales)
    np.testing.assert_allclose(scales[0], (0.6, 0.1, 0.6), rtol=1e-5)
    np.testing.assert_allclose(scales[1], (0.2 * np.hypot(30, 3),) * 2 + (0.1,), rtol=1e-5)
    assert (values.log_scales[2:] == before[2:]).all()
