"""Files become slots: what goes on, in which layer, on which lattice."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from codec.lattice.lattice import dequantise
from codec.sequence import slotfiller
from codec.sequence.matching import match
from codec.sequence.slotfiller import KINDS, ErrorBound, SlotFiller, SlotPlan
from codec.slots.slotlayout import ENDED, KEPT, NEW, PREDICTED, Update
from codec.splats import Splats
from codec.stream.wholeslice import coverage_rank, opacity_rank
from tests.support.deforming import Deforming
from tests.support.drawn import drawn_splats
from tests.support.slots.rotating import figure, turned
from tests.support.trained_like import trained_like_splats


@settings(max_examples=60, deadline=None)
@given(splats=drawn_splats(max_count=12), seed=st.integers(0, 1 << 32))
def test_the_same_bits_go_on_in_any_order(splats: Splats, seed: int) -> None:
    """The match also holds with duplicates, births and deaths."""
    rng = np.random.default_rng(seed)
    rows = rng.integers(0, max(len(splats), 1), len(splats)) if len(splats) else np.zeros(0, int)
    before = splats.take(rows)  # some Gaussians occur twice
    order = rng.permutation(len(before))[: rng.integers(0, len(before) + 1)]
    after = before.take(order)
    continued, same = match(before, after)
    assert same.all()
    for array, earlier in zip(after.arrays, before.arrays, strict=True):
        assert (array == earlier[continued]).all()
    assert len(np.unique(continued)) == len(continued)


@settings(max_examples=60, deadline=None)
@given(a=drawn_splats(max_degree=0, position=1), b=drawn_splats(max_degree=0, position=1))
def test_pairs_are_pairs_whatever_the_files(a: Splats, b: Splats) -> None:
    continued, same = match(a, b)
    assert continued.shape == same.shape == (len(b),)
    used = continued[continued >= 0]
    assert len(np.unique(used)) == len(used)
    assert ((continued >= -1) & (continued < len(a))).all()
    again, _ = match(a, b)
    assert (again == continued).all()


def test_colours_tell_what_a_deformation_network_moves_far() -> None:
    """The match holds in any order, although most Gaussians moved farther than their spacing."""
    deforming = Deforming(4000, 3)
    before, after = deforming.next(), deforming.next()
    continued, same = match(before, after)
    goes_on = continued >= 0
    assert goes_on.mean() > 0.97
    equal = (before.sh[continued[goes_on]] == after.sh[goes_on]).all(axis=(1, 2))
    assert equal.mean() > 0.99
    assert not same.any()


def test_colours_that_many_share_tell_nothing() -> None:
    before = figure(2000)
    grey = Splats(*before.arrays[:4], np.full((2000, 1, 3), 0.25, np.float32))
    order = np.random.default_rng(1).permutation(2000)
    after = turned(grey, 0.01).take(order)
    continued, _ = match(grey, after)
    right = continued == order
    assert right[continued >= 0].mean() > 0.9


@pytest.mark.parametrize("count", [3000, 12000])
def test_the_order_of_the_files_tells_where_everything_moves_far(count: int) -> None:
    before, after = figure(count), turned(figure(count), 0.1)
    continued, same = match(before, after)
    assert (continued == np.arange(count)).mean() > 0.999
    assert not same.all()


def test_place_and_looks_tell_where_the_order_does_not() -> None:
    before = figure(4000)
    order = np.random.default_rng(0).permutation(4000)
    after = turned(before, 0.02).take(order)
    continued, _ = match(before, after)
    assert (continued == order).mean() > 0.8
    # With some Gaussians gone and others new, there are still few mistakes.
    stays = np.arange(4000) >= 300
    continued, _ = match(before.take(np.flatnonzero(stays)), after)
    true = np.where(stays[order], order - 300, -1)
    assert (continued == true).mean() > 0.75


def test_two_files_that_have_nothing_to_do_with_each_other_have_few_pairs() -> None:
    before, after = trained_like_splats(2000, 1), trained_like_splats(2000, 2)
    continued, same = match(before, after)
    assert not same.any()
    far = continued >= 0
    moves_m = np.linalg.norm(after.means[far] - before.means[continued[far]], axis=1)
    sizes_m = np.exp(np.sort(before.log_scales[continued[far]], axis=1)[:, 1:].mean(axis=1))
    assert far.mean() < 0.3
    assert (moves_m <= 4.01 * sizes_m + 1e-6).mean() > 0.9


def planned(splats: Splats, slots: tuple[int, ...]) -> SlotPlan:
    """A plan whose shares are those of the slots."""
    error, size_m = ErrorBound(), 0.01
    bounds = np.array([[error.of(kind) for kind in KINDS]] * len(slots))
    bounds[:, 0] *= size_m
    lattice = error.lattice(size_m, -12, 0)
    shares = tuple(count / sum(slots) for count in slots)
    return SlotPlan(slots, shares, 0, (lattice,) * len(slots), bounds, -np.ones(3), np.ones(3))


def counted(update: Update) -> list[int]:
    return [int(count) for count in np.bincount(update.statuses, minlength=4)]


def test_the_most_important_are_in_the_first_layer() -> None:
    splats = figure(100)
    update = SlotFiller(planned(splats, (20, 30, 50)), opacity_rank).update(0, splats)
    assert (update.statuses == NEW).all()
    logits = [
        states.attributes[:, -1].astype(int)
        for states in (update.states.take(slice(0, 20)), update.states.take(slice(20, 50)))
    ]
    assert logits[0].min() >= logits[1].max()


def test_a_file_with_fewer_fills_every_layer_by_its_share() -> None:
    splats = figure(100)
    plan = planned(splats, (20, 30, 50))
    update = SlotFiller(plan, coverage_rank).update(0, splats.take(slice(0, 50)))
    full = update.statuses == NEW
    assert [int(full[a:b].sum()) for a, b in ((0, 20), (20, 50), (50, 100))] == [10, 15, 25]


def test_slots_end_and_are_used_again() -> None:
    splats = figure(60)
    filler = SlotFiller(planned(splats, (30, 30)), coverage_rank)
    filler.update(0, splats)
    assert counted(filler.update(1, splats)) == [60, 0, 0, 0]
    assert counted(filler.update(2, splats.take(slice(0, 40)))) == [40, 20, 0, 0]
    assert counted(filler.update(3, splats.take(slice(0, 40)))) == [60, 0, 0, 0]
    # Ten of the removed Gaussians, far away, and the rest turned slightly.
    late = figure(70, 1).take(slice(60, 70))
    late = replace(late, means=late.means + np.float32(7))
    both = Splats.concatenate([turned(splats.take(slice(0, 40)), 0.05), late])
    _, ended, predicted, new = counted(filler.update(4, both))
    assert (ended, predicted, new) == (0, 40, 10)
    assert counted(filler.update(5, both.take(slice(0, 0)))) == [10, 50, 0, 0]
    assert filler.statuses.sum() == 5 * 60


def test_what_a_lattice_cannot_hold_is_sent_as_it_is_and_kept_while_it_stays() -> None:
    splats = figure(30)
    means = splats.means.copy()
    means[:3] = 1e6
    splats = replace(splats, means=means)
    filler = SlotFiller(planned(splats, (30,)), coverage_rank)
    update = filler.update(0, splats)
    assert update.escaped.sum() == 3
    assert sorted(map(bytes, update.escapes.means)) == sorted(map(bytes, means[:3]))
    assert counted(filler.update(1, splats)) == [30, 0, 0, 0]
    back = means.copy()
    back[0] = 0.5
    changed = filler.update(2, replace(splats, means=back))
    assert counted(changed)[KEPT] == 29
    assert counted(changed)[NEW] == 1
    assert not changed.escaped.any()
    moved = filler.update(3, replace(splats, means=means + np.float32(0.1)))
    assert counted(moved)[PREDICTED] == 27
    assert counted(moved)[ENDED] == 0


def test_a_frame_may_be_taken_in_blocks(monkeypatch: pytest.MonkeyPatch) -> None:
    splats = figure(50)
    whole = SlotFiller(planned(splats, (20, 30)), coverage_rank)
    wanted = [whole.update(n, turned(splats, 0.03 * n)) for n in range(3)]
    monkeypatch.setattr(slotfiller, "BLOCK", 7)
    blocks = SlotFiller(planned(splats, (20, 30)), coverage_rank)
    for number, update in enumerate(wanted):
        found = blocks.update(number, turned(splats, 0.03 * number))
        assert (found.statuses == update.statuses).all()
        assert (found.states.positions == update.states.positions).all()
        assert (found.states.attributes == update.states.attributes).all()
    assert (blocks.errors == whole.errors).all()


def test_noise_about_the_middle_between_two_steps_is_held() -> None:
    splats = figure(200)
    plan = planned(splats, (200,))
    filler = SlotFiller(plan, coverage_rank)
    step_m = plan.lattices[0].position_m
    middle = np.floor(splats.means / step_m) * step_m + 0.5 * step_m
    rng = np.random.default_rng(0)
    first = filler.update(0, replace(splats, means=middle.astype(np.float32)))
    decoded = dequantise(first.states, plan.lattices[0])
    assert abs(np.sort(decoded.means, 0) - np.sort(middle, 0)).max() < 0.51 * step_m
    for number in range(1, 4):
        noisy = middle + rng.uniform(-0.2, 0.2, middle.shape) * step_m
        update = filler.update(number, replace(splats, means=noisy.astype(np.float32)))
        assert counted(update)[KEPT] == 200
    assert 0.6 * step_m < filler.errors[0] <= 0.75 * step_m * (1 + 1e-6)
