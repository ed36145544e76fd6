"""The lattice and the mathematics under it (codec/FORMAT.md, section 8.1)."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from codec.errors import InvalidError
from codec.lattice.forms import (
    MAX_COARSENESS,
    MAX_LOGIT,
    MIN_COARSENESS,
    canonical,
    layer_coarseness,
    opacity_logits,
    position_step_m,
    to_luma,
)
from codec.lattice.lattice import MAX_HOLD, MIN_STEP, POSITION_LIMIT, dequantise, quantise
from codec.splats import SH_C0, Splats
from tests.support.hostile import refused
from tests.support.slots.rotating import figure, turned
from tests.support.slots.updates import LATTICE, patternless_splats
from tests.support.trained_like import covariances, trained_like_splats

MINE = replace(LATTICE, log_scale_base=-4.0)


STEPS = (0.0, 9e-7, 1.1e6, -1.0, math.inf, math.nan), (MIN_STEP, 1e6)


@pytest.mark.parametrize(
    ("name", "wrong", "good"),
    [
        *((name, *STEPS) for name in ("position_m", "log_scale", "rotation", "colour")),
        ("log_scale_base", (1000.1, -1000.1, math.inf, math.nan), (-1e3, 0.1, 1e3)),
        ("opacity_levels", (1, 257), (2, 256)),
    ],
)
def test_each_has_bounds(name: str, wrong: tuple[float, ...], good: tuple[float, ...]) -> None:
    for value in wrong:
        refused(InvalidError, name, replace, LATTICE, **{name: value})
    for value in good:  # the nearest f32 of MIN_STEP is below it, but it is valid
        made = replace(LATTICE, **{name: value})  # type: ignore[arg-type]
        assert getattr(made, name) == np.float32(value)
        assert replace(made) == made


def test_what_comes_back_is_within_half_a_step() -> None:
    splats = patternless_splats(np.random.default_rng(0), 500, 0)
    splats = replace(splats, log_scales=splats.log_scales - np.float32(4))
    states, fits = quantise(splats, MINE)
    assert fits.mean() > 0.9
    found = dequantise(states, MINE)
    for steps, errors in (
        (MINE.position_m, found.means - splats.means),
        # A Gaussian may come back with its axes in another order.
        (MINE.log_scale, np.sort(found.log_scales) - np.sort(splats.log_scales)),
        (MINE.rotation, (found.quats - canonical(splats.log_scales, splats.quats)[1])[:, 1:]),
        (MINE.colour, to_luma((found.sh - np.maximum(splats.sh, -0.5 / SH_C0)).astype(np.float64))),
        (1 / (MINE.opacity_levels - 1), found.opacities - splats.opacities),
    ):
        assert abs(errors[fits]).max() <= 0.5 * steps + 1e-5


def test_a_flat_axis_is_taken_to_the_lowest_scale_and_a_long_one_escapes() -> None:
    splats = patternless_splats(np.random.default_rng(1), 3, 0)
    low, high = (MINE.log_scale_base + MINE.log_scale * n for n in (-128, 127))
    sizes = np.array([[low - 50, -4, -4], [high + 1, -4, -4], [-1e30, -4, -4]], np.float32)
    states, fits = quantise(replace(splats, log_scales=sizes), MINE)
    assert fits.tolist() == [True, False, True]
    assert dequantise(states, MINE).log_scales[[0, 2]].min(axis=1).tolist() == [low, low]
    far = np.array([[POSITION_LIMIT - 1, 0, 0], [POSITION_LIMIT, 0, 0], [1e37, 0, 0]], np.float32)
    means = far * np.float32(MINE.position_m)
    same = np.full((3, 3), -4, np.float32)
    _, fits = quantise(replace(splats, means=means, log_scales=same), MINE)
    assert fits.tolist() == [True, False, False]


def test_what_is_near_enough_is_held() -> None:
    splats = patternless_splats(np.random.default_rng(2), 200, 0)
    splats = replace(splats, log_scales=splats.log_scales - np.float32(4))
    before, _ = quantise(splats, MINE)
    shift = np.float32(1.4 * MINE.position_m)
    moved = replace(splats, means=splats.means + shift)
    held, _ = quantise(moved, MINE, before, hold=2)
    assert (held.positions == before.positions).all()
    followed, _ = quantise(moved, MINE, before)
    assert (followed.positions > before.positions).all()
    for hold in (-0.1, MAX_HOLD + 0.1, float("nan")):
        refused(InvalidError, "hold", quantise, moved, MINE, before, hold)


def test_the_form_of_what_goes_on_does_not_jump() -> None:
    """The figure turns, and the order of its axes by size changes: a small step stays small."""
    first = figure(100)
    states, _ = quantise(first, LATTICE)
    jumps = 0
    for frame in range(1, 40):
        sizes = -3 + np.sin(0.05 * frame + np.arange(3, dtype=np.float32))
        now = turned(replace(first, log_scales=np.tile(sizes, (100, 1))), 0.02 * frame)
        after, _ = quantise(now, LATTICE, states if frame > 1 else None)
        fresh, _ = quantise(now, LATTICE)
        if frame > 1:
            old, new, alone = (dequantise(one, LATTICE) for one in (states, after, fresh))
            assert abs(old.log_scales - new.log_scales).max() < 0.2
            assert abs(old.quats - new.quats)[:, 1:].max() < 0.1
            jumps += int((abs(old.log_scales - alone.log_scales) > 0.2).any(axis=1).sum())
        states = after
    assert jumps > 100


numbers = st.floats(-1, 1, width=32)
scales = st.tuples(*[st.floats(-8, 3, width=32)] * 3)


@given(
    st.tuples(*[numbers] * 4).filter(lambda q: max(map(abs, q)) > 1e-3),
    scales,
    st.sampled_from([1e-36, 1.0, 1e36]),
)
@settings(max_examples=300)
def test_canonical_form(quat: tuple[float, ...], log_scale: tuple[float, ...], norm: float) -> None:
    quats = np.array([quat], np.float32)
    log_scales = np.array([log_scale], np.float32)
    found_scales, found_quats = canonical(log_scales, quats * np.float32(norm))
    assert (np.diff(found_scales) <= 0).all()
    assert np.linalg.norm(found_quats) == pytest.approx(1, abs=1e-12)
    assert (np.abs(found_quats[:, 1:]) <= found_quats[:, :1] + 1e-12).all()
    expected = covariances(log_scales.astype(float), quats.astype(float))
    actual = covariances(found_scales, found_quats)
    assert np.abs(actual - expected).max() <= 1e-5 * np.exp(2 * log_scales.max())


@pytest.mark.parametrize("levels", [2, 3, 225, 256])
def test_opacity_logits_invert_the_opacity(levels: int) -> None:
    logits = opacity_logits(levels).astype(float)
    opacities = 1 / (1 + np.exp(-logits))
    assert opacities == pytest.approx(np.arange(levels) / (levels - 1), abs=2e-7)
    assert (logits[0], logits[-1]) == (-MAX_LOGIT, MAX_LOGIT)
    assert (np.diff(logits) > 0).all()


def test_position_steps_follow_the_scale_of_the_scene() -> None:
    splats = trained_like_splats(1000)
    grown = Splats(
        splats.means * np.float32(math.e**2),
        splats.log_scales + np.float32(2),
        splats.quats,
        splats.logit_opacities,
        splats.sh,
    )
    assert position_step_m(grown) == pytest.approx(math.e**2 * position_step_m(splats), rel=1e-4)
    assert position_step_m(Splats.empty()) > 0


def test_less_important_layers_are_coarser() -> None:
    splats = trained_like_splats(4000)
    order = np.argsort(-splats.logit_opacities)
    factors = layer_coarseness([splats.take(rows) for rows in np.array_split(order, 4)])
    assert factors == sorted(factors)
    assert factors[0] < 1 < factors[-1]
    assert all(MIN_COARSENESS <= factor <= MAX_COARSENESS for factor in factors)
    assert layer_coarseness([splats]) == pytest.approx([1])
    assert layer_coarseness([Splats.empty(), Splats.empty()]) == [1, 1]
