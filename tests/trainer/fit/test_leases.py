"""The slots sent are exactly those that training renders; and seams of two trainings."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from codec.errors import InvalidError
from codec.lattice.lattice import Lattice
from codec.slice import active_splats
from codec.slots.decoder import SlotDecoder
from codec.slots.encoder import SlotEncoder
from codec.slots.slotlayout import ENDED, KEPT, NEW, PREDICTED, SlotLayout, Update
from codec.splats import Splats
from player.render.cpu import render_splats
from trainer.fit.config import FitConfig, Schedule, WindowPlan
from trainer.fit.generations import Generations
from trainer.fit.leasedslots import LeasedSlots
from trainer.fit.mcmc import McmcConfig
from trainer.fit.renew import ChangeScores
from trainer.fit.trainer import Trainer
from trainer.lease.leases import ByteBudget, LeaseConfig, Leases
from trainer.lease.takeover import Crossfade, PlayerState, turns
from trainer.step.contribution import contribution
from trainer.step.loss import psnr_db
from trainer.step.raster import Parameters, View, render

from .test_trainer import NEAR_M, Rendered, start, truth

SLOTS = {1: (40, 20, 30), 3: (12, 8, 10)}


def layout(swin_size: int, *slots: int, sh_degree: int = 0) -> SlotLayout:
    lattices = (Lattice.suiting(truth(0)),) * len(slots)
    return SlotLayout(swin_size, slots, sh_degree, lattices, 15)


def config(swin_size: int, **lease: float) -> FitConfig:
    return FitConfig(
        num_gs=90, swin_size=swin_size, genesis_iterations=200, settle_rounds=1,
        window_iterations=60, calm_from=0.7, prefix_share=0.2,
        mcmc=replace(McmcConfig(), relocate_period=25, renew_share=0.05),
        lease=LeaseConfig(**lease),
    )  # fmt: skip


def trainer_of(chosen: FitConfig, layout: SlotLayout, takeover: Crossfade | None = None) -> Trainer:
    leased = partial(LeasedSlots, layout=layout, takeover=takeover)
    initial = start().with_degree(chosen.sh_degree)
    return Trainer(chosen, Rendered(), initial, NEAR_M, strategy=leased)


class Player:
    """Decodes every update as it is sent."""

    def __init__(self, layout: SlotLayout) -> None:
        self.encoder, self.decoder = SlotEncoder(layout), SlotDecoder(layout)

    def ingest(self, update: Update) -> None:
        encoded = self.encoder.append(update)
        if update.birth == 0:
            for layer, keyframe in enumerate(self.encoder.keyframes()):
                self.decoder.load(keyframe.data, layer, 0)
        elif encoded is not None:
            changes = [change.data for change in encoded.changes]
            self.decoder.apply(update.birth, encoded.skip_map.data, changes)

    def shown(self, frame: int) -> Splats:
        return active_splats(self.decoder.window(frame), frame, self.encoder.layout.swin_size)


def sorted_rows(splats: Splats) -> np.ndarray:
    rows = np.concatenate([a.reshape(len(splats), -1) for a in splats.arrays], axis=1)
    rows = rows[splats.opacities > 1 / 255]
    return rows[np.lexsort(rows.T)]


@pytest.mark.parametrize(
    ("swin_size", "share", "sh_degree"),
    [(1, 1.0, 0), (1, 0.3, 0), (3, 1.0, 0), (3, 0.3, 0), (1, 0.3, 3)],
)
def test_a_player_shows_what_training_shows(swin_size: int, share: float, sh_degree: int) -> None:
    chosen = config(swin_size, active_share=share, refresh_share=0.05)
    chosen = replace(chosen, sh_degree=sh_degree)
    sizes = layout(swin_size, *SLOTS[swin_size], sh_degree=sh_degree)
    trainer = trainer_of(chosen, sizes)
    player, kept = Player(sizes), 0
    for window in trainer.windows():
        assert not window.slices
        for update in window.updates:
            assert not update.escaped.any()
            player.ingest(update)
            kept += int((update.statuses == KEPT).sum()) if update.birth > 0 else 0
            active = (update.statuses != KEPT).sum()
            if update.birth > 0:
                assert active <= round(share * 90 / swin_size) + round(0.05 * 90) + 2
        frame = window.first_frame
        assert np.array_equal(sorted_rows(player.shown(frame)), sorted_rows(trainer.shown(frame)))
    assert kept or share == 1
    for camera in Rendered().cameras[:2]:
        shown = render_splats(player.shown(4), camera, NEAR_M)
        seen = render_splats(truth(4), camera, NEAR_M)
        assert psnr_db(np.clip(shown, 0, 1), np.clip(seen, 0, 1)) > 22


def test_a_slot_goes_on_unless_another_gaussian_takes_it() -> None:
    leases = Leases(LeaseConfig(), layout(1, 3, 2))
    splats = truth(0).take(slice(0, 5))
    everyone = np.ones(5, np.bool_)
    offsets = np.zeros(5, np.int32)
    first, exact = leases.mature(0, slice(0, 5), everyone, splats, offsets)
    assert (first.statuses == NEW).all()
    same, _ = leases.mature(1, slice(0, 5), everyone, exact, offsets)
    assert (same.statuses == KEPT).all()
    moved = Splats(exact.means + np.float32(0.5), *exact.arrays[1:])
    leases.is_other[3] = True
    some = np.array([True, False, True, True, False])
    update, _ = leases.mature(2, slice(0, 5), some, moved, offsets)
    assert update.statuses.tolist() == [PREDICTED, KEPT, PREDICTED, NEW, KEPT]
    dim = Splats(*exact.arrays[:3], np.full(5, -9, np.float32), exact.sh)
    gone, _ = leases.mature(3, slice(0, 5), everyone, dim, offsets)
    assert (gone.statuses == ENDED).all()
    again, _ = leases.mature(4, slice(0, 5), everyone, dim, offsets)
    assert (again.statuses == KEPT).all()
    # A Gaussian off the lattice is sent as it is.
    splats.means[2] = 1e9
    escaped, exact = leases.mature(5, slice(0, 5), everyone, splats, offsets)
    assert escaped.escaped.tolist() == [False, False, True, False, False]
    assert (escaped.escapes.means == 1e9).all()
    assert (exact.means[2] == 1e9).all()


@given(st.integers(1, 3), st.integers(1, 7), st.integers(1, 7), st.integers(0, 99))
def test_dealing_permutes_within_layers(lanes: int, first: int, second: int, seed: int) -> None:
    rng = np.random.default_rng(seed)
    leases = Leases(LeaseConfig(), layout(lanes, first, second))
    count = lanes * (first + second)
    contributions = rng.random(count)
    leases.rank(contributions)
    order = leases.deal(rng.normal(size=(count, 3)).astype(np.float32), rng)
    assert sorted(order.tolist()) == list(range(count))
    least_first = np.sort(contributions)
    of_first = contributions[order][leases.layers == 0]
    assert sorted(of_first) == least_first[count - lanes * first :].tolist()
    pattern = [0] * first + [1] * second
    assert leases.layers.tolist() == pattern * lanes


def test_active_are_those_that_changed_and_the_oldest() -> None:
    leases = Leases(LeaseConfig(active_share=0.5, refresh_share=0.2), layout(1, 10))
    leases.trained[:] = [9, 9, 9, 9, 9, 2, 1, 9, 9, 0]
    scores = np.array([5, 0, 4, 0, 3, 0.1, 0.1, 0.2, 0, 0])
    rows = np.arange(10, dtype=np.int32)
    assert leases.choose(rows, scores).tolist() == [0, 2, 4, 5, 6]


def test_weights_are_contributions_and_change_is_found_where_it_is() -> None:
    pictures = Rendered()
    splats = truth(0)
    rows = np.arange(40, dtype=np.int32)
    scores = ChangeScores(40)
    for camera in pictures.cameras:
        view = View.prepare(camera, NEAR_M)
        rendered = render(Parameters(*splats.arrays), rows, view)
        now = render_splats(truth(0), camera, NEAR_M) - render_splats(truth(4), camera, NEAR_M)
        counts = np.ones(now.shape[:2], np.bool_)
        weights = scores.add(rendered, now, np.zeros_like(now), counts)
        np.testing.assert_allclose(weights, contribution(rendered), rtol=1e-4, atol=1e-4)
    by_score = np.argsort(-scores.scores)
    assert np.isin(by_score[:8], np.arange(10)).sum() >= 6  # these ten drift


def test_a_budget_is_kept_over_time() -> None:
    budget = ByteBudget(10_000)
    rng = np.random.default_rng(0)
    sent = 0
    for _ in range(300):
        slots = budget.slots
        num_bytes = round(slots * rng.uniform(3, 9)) + 500
        budget.record_sent_bytes(num_bytes, slots)
        sent += num_bytes
    assert abs(sent / 300 - 10_000) < 500
    for _ in range(100):  # nothing happens: the saved budget is bounded
        budget.record_sent_bytes(0, 0)
    assert budget.slots < 2 * 10_000 / 3


def test_a_trainer_keeps_to_the_bytes_that_it_may_send() -> None:
    chosen = config(1, active_share=1.0, bytes_per_frame=100.0)
    trainer = trainer_of(chosen, layout(1, *SLOTS[1]))
    active = []
    for window in trainer.windows():
        active.append(int((window.updates[-1].statuses != KEPT).sum()))
        trainer.strategy.record_sent_bytes(window, 10 * active[-1])
    assert active[0] >= 80  # of 90: all visible ones
    assert max(active[1:]) <= 20 + 5  # the price is 5 at first; renewal is added
    assert min(active[1:]) >= 5


def test_a_gaussian_that_matters_comes_into_a_lower_layer(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("trainer.lease.leases.TRADE_SHARE", 0.2)
    leases = Leases(LeaseConfig(), layout(1, 4, 3, 3))
    leases.is_shown[:] = True
    contributions = np.array([9, 1, 9, 9, 5, 3, 5, 8, 3.9, 9], np.float32)
    rows = np.arange(10, dtype=np.int32)
    low, high = leases.trades(rows, contributions)
    assert (low.tolist(), high.tolist()) == ([1], [9])  # 8 does not exceed four times 3
    leases.is_shown[9] = False
    assert leases.trades(rows, contributions)[0].tolist() == []


def test_a_window_marks_what_it_exchanges_as_another_gaussian(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr("trainer.lease.leases.TRADE_SHARE", 0.1)
    chosen = replace(config(1, active_share=0.5), together_share=0.0)
    strategy = trainer_of(chosen, layout(1, *SLOTS[1])).strategy
    assert isinstance(strategy, LeasedSlots)
    strategy.mature(range(1))
    generations, leases = strategy.fit.generations, strategy.leases
    leases.is_other[:] = False
    before = generations.values.means[:90].copy()
    schedule = Schedule.window(chosen, 1e-3)
    plan = WindowPlan(range(1, 2), schedule, None, 0, 0, True, 0.0, 0.0)
    assert not strategy.begin_window(plan).whole
    changed = (generations.values.means[:90] != before).any(axis=1)
    assert 2 < changed.sum() < 45
    assert np.array_equal(changed, leases.is_other)
    assert not generations.lifespans.kept(slice(90))[changed].any()


def test_who_changes_places_takes_everything_along() -> None:
    generations = Generations(config(1), start())
    generations.adam.steps[:] = np.arange(90)
    before = [array[:90].copy() for array in generations.values.arrays]
    generations.trade(np.array([3, 7]), np.array([60, 80]))
    for was, now in zip(before, generations.values.arrays, strict=True):
        assert (now[[3, 7, 60, 80]] == was[[60, 80, 3, 7]]).all()
    assert generations.adam.steps[[3, 60]].tolist() == [60, 3]


SEAM = range(1, 4)


def untrained(seed: int, takeover: Crossfade | None = None) -> tuple[Trainer, SlotEncoder]:
    """A trainer before its first window, and an encoder for its updates."""
    settings, slots = replace(config(1, active_share=0.4), seed=seed), layout(1, *SLOTS[1])
    return trainer_of(settings, slots, takeover), SlotEncoder(slots)


def assert_same_slots(one: SlotEncoder, other: SlotEncoder) -> None:
    for mine, theirs in zip(one.lanes[0], other.lanes[0], strict=True):
        assert np.array_equal(mine.conditions, theirs.conditions)
        assert np.array_equal(mine.states.positions, theirs.states.positions)
        assert np.array_equal(mine.states.attributes, theirs.states.attributes)


def test_after_a_seam_the_other_training_goes_on_as_if_heard_from_the_beginning() -> None:
    other, other_encoder = untrained(1)
    held: dict[int, PlayerState] = {}
    theirs: dict[int, Update] = {}
    for window in other.windows():
        for update in window.updates:
            other_encoder.append(update)
            theirs[update.birth] = update
        held |= {h.birth: h for h in other.strategy.held(window)}
    one, encoder = untrained(0, Crossfade({birth: held[birth] for birth in SEAM}, 1, 0))
    changed = []
    for window in one.windows():
        for update in window.updates:
            encoder.append(update)
        (mine,) = one.strategy.held(window)
        if window.first_frame in SEAM:
            wanted = held[window.first_frame]
            same = (mine.states.positions == wanted.states.positions).all(axis=1)
            changed.append(same.mean())
        # The shown Gaussians are those of a player.
        shown = sorted_rows(one.shown(window.first_frame))
        drawn = sorted_rows(mine.splats.take(np.flatnonzero(mine.shows)))
        assert np.array_equal(shown, drawn)
        if window.first_frame == SEAM[-1]:
            break
    assert changed[-1] == 1
    assert changed[0] < 0.6
    assert all(np.diff(changed) > -0.05)
    for birth in range(SEAM.stop, max(theirs) + 1):
        encoder.append(theirs[birth])  # raises if it does not fit
    assert_same_slots(encoder, other_encoder)


@given(st.integers(1, 300), st.integers(1, 20), st.integers(0, 5))
def test_all_have_a_turn_and_as_many_each_time(num: int, count: int, seed: int) -> None:
    rng = np.random.default_rng(seed)
    drawn = turns(rng.normal(size=(num, 3)).astype(np.float32), count, rng)
    assert drawn.min() >= 0
    assert drawn.max() < count
    sizes = np.bincount(drawn, minlength=count)
    assert sizes.max() - sizes.min() <= 4


def test_what_is_held_survives_as_arrays_and_as_an_opening() -> None:
    one, encoder = untrained(0)
    window = next(one.windows())
    (update,) = window.updates
    encoder.append(update)
    (held,) = one.strategy.held(window)
    again = PlayerState.from_arrays(held.to_arrays())
    for name, array in held.to_arrays().items():
        assert np.array_equal(array, again.to_arrays()[name])
    opened = SlotEncoder.opened(encoder.layout, [held.as_opening()])
    assert opened.next_birth == encoder.next_birth == 1
    assert_same_slots(opened, encoder)
    # A seam needs births that follow each other.
    for births in ([], [1, 3]):
        with pytest.raises(InvalidError, match="seam"):
            Crossfade({birth: replace(held, birth=birth) for birth in births}, 1, 0)
    with pytest.raises(InvalidError, match="after genesis"):
        untrained(0)[0].jump(5)
