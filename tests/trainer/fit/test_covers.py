"""A first layer that trains by itself: the others begin as covers of it, and none takes from one
below it."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from codec.camera import rotation_of
from codec.splats import Splats
from trainer.fit.config import Schedule, WindowPlan
from trainer.fit.leasedslots import COVER_OPACITY, COVER_SCALE, LeasedSlots, covers_of
from trainer.fit.trainer import Trainer
from trainer.lease.leases import LeaseConfig, Leases

from .test_leases import SLOTS, config, layout, trainer_of
from .test_trainer import NEAR_M, Rendered, Telling, start

LAYERS = layout(1, *SLOTS[1])
FAINT, HAZE, CLEAR = -4.0, -2.0, 2.0
"""Logits of opacities: dead while genesis settles, dead then in the first layer alone, not dead."""


def plan_of(settled: int) -> WindowPlan:
    schedule = Schedule.window(config(1), 1e-3)
    return WindowPlan(range(1), schedule, settled, 0, 0, False, 0.0, 0.0)


def test_covers_together_are_as_large_as_the_gaussian_below_and_lie_where_it_does() -> None:
    rng = np.random.default_rng(2)
    below = start().take(slice(0, 3))
    quats = rng.normal(size=(3, 4)).astype(np.float32)
    log_scales = rng.normal(-2, 1, (3, 3)).astype(np.float32)
    below = Splats(below.means, log_scales, quats, below.logit_opacities, below.sh)
    count = 40_000
    covers = covers_of(below.take(np.repeat(np.arange(3), count)), rng)
    np.testing.assert_allclose(covers.opacities, COVER_OPACITY, rtol=1e-5)
    scales, sizes = np.exp(covers.log_scales), np.exp(np.repeat(log_scales, count, axis=0))
    np.testing.assert_allclose(scales, COVER_SCALE * sizes, rtol=1e-4)
    for i, quat in enumerate(quats):
        mine = slice(i * count, (i + 1) * count)
        assert (covers.quats[mine] == quat).all()
        assert (covers.sh[mine] == below.sh[i]).all()
        axes = rotation_of(quat.astype(np.float64) / np.linalg.norm(quat))
        places = (covers.means[mine] - below.means[i]) @ axes / np.exp(log_scales[i])
        # In units of the Gaussian below: the covariance of all covers is 0.85 of its own.
        together = np.cov(places.T) + COVER_SCALE**2 * np.eye(3)
        np.testing.assert_allclose(together, 0.85 * np.eye(3), atol=0.02)
        np.testing.assert_allclose(places.mean(axis=0), 0, atol=0.02)


@pytest.mark.parametrize("settled", [0, 1])
@pytest.mark.parametrize("dead_share", [0.1, 0.5, 0.9])
def test_no_gaussian_takes_from_a_lower_layer(settled: int, dead_share: float) -> None:
    strategy = trainer_of(
        replace(config(1), settle_rounds=2, settle_base_share=0.5), LAYERS
    ).strategy
    assert isinstance(strategy, LeasedSlots)
    generations, leases = strategy.fit.generations, strategy.leases
    for earlier in range(settled + 1):  # the first round is the base's
        strategy.begin_window(plan_of(earlier))
    rng = np.random.default_rng(4)
    dead = rng.random(90) < dead_share
    hazy = (rng.random(90) < 0.3) & ~dead
    generations.values.sh[:90] = rng.normal(size=generations.values.sh[:90].shape)  # who is whose
    generations.values.logit_opacities[:90] = np.where(dead, FAINT, np.where(hazy, HAZE, CLEAR))
    dead |= hazy & (leases.layers == 0)
    leases.is_other[:] = False
    layers, shown = leases.layers.copy(), generations.lifespans.active_rows(0)
    before = [array[:90].copy() for array in generations.values.arrays]
    strategy.after_step(plan_of(settled), 25)
    changed = np.zeros(90, np.bool_)
    for was, now in zip(before, generations.values.arrays, strict=True):
        changed |= (was != now[:90]).reshape(90, -1).any(axis=1)
    assert np.array_equal(changed & dead, leases.is_other)
    if settled == 0:
        assert (layers[shown] == 0).all()
        assert not changed[layers > 0].any()
    sh = generations.values.sh[:90]
    for row in np.flatnonzero(changed & dead):
        (target,) = np.flatnonzero(~dead & (sh == sh[row]).all(axis=(1, 2)))
        assert layers[target] >= layers[row]


def test_the_first_layer_trains_alone_and_a_run_resumed_then_sends_the_same_updates() -> None:
    chosen = replace(
        config(1), genesis_iterations=20, settle_rounds=3, window_iterations=20,
        settle_base_share=0.3, settle_prefix_share=0.5,
        mcmc=replace(config(1).mcmc, relocate_period=5),
    )  # fmt: skip
    leased, keeping = partial(LeasedSlots, layout=LAYERS), Telling()
    pictures, first = Rendered(), start()
    trainer = Trainer(chosen, pictures, first, NEAR_M, observers=[keeping], strategy=leased)
    keeping.trainer = trainer
    (whole,) = next(trainer.windows()).updates
    # Before settling, in its rounds, and with the last of them.
    shown = [set(s["lease_layers"][s["starts"] < s["expires"]].tolist()) for s in keeping.states]
    assert shown == [{0}, {0}, {0, 1, 2}, {0, 1, 2}]
    for done, state in zip((20, 40, 60, 80), keeping.states, strict=True):
        telling = Telling()
        other = Trainer(chosen, pictures, None, NEAR_M, observers=[telling], strategy=leased)
        other.restore(state)
        (update,) = next(other.windows()).updates
        later = [f"{n} of 80" for n in range(done + 20, 100, 20)]
        assert telling.told == [f"begun 0 at {done}", *later]
        assert np.array_equal(update.statuses, whole.statuses)
        assert np.array_equal(update.states.numbers(), whole.states.numbers())


@given(st.lists(st.integers(1, 40), min_size=1, max_size=5), st.floats(0, 1), st.integers(0, 99))
def test_each_layer_changes_by_its_share(slots: list[int], share: float, seed: int) -> None:
    leases = Leases(LeaseConfig(active_share=share, refresh_share=0), layout(1, *slots))
    rng, count = np.random.default_rng(seed), sum(slots)
    leases.rank(rng.random(count))
    chosen = leases.choose(np.arange(count, dtype=np.int32), rng.random(count) + 0.1, True)
    assert len(chosen) == round(share * count)
    active = np.bincount(leases.layers[chosen], minlength=len(slots))
    assert (np.abs(active - share * np.array(slots)) <= 1.5).all()
