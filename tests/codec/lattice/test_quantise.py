"""Orientation, colour and steps: the mathematics under the lattice."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from codec.lattice.orientation import canonical, multiply
from codec.lattice.quantise import (
    MAX_COARSENESS,
    MAX_LOGIT,
    MIN_COARSENESS,
    from_luma,
    layer_coarseness,
    opacity_logits,
    position_step_m,
    to_luma,
)
from codec.splats import Splats
from tests.support.trained_like import covariances, trained_like_splats

numbers = st.floats(-1, 1, width=32)
scales = st.tuples(*[st.floats(-8, 3, width=32)] * 3)


@given(
    st.tuples(*[numbers] * 4).filter(lambda q: max(map(abs, q)) > 1e-3),
    scales,
    st.sampled_from([1e-36, 1.0, 1e36]),
)
@settings(max_examples=300)
def test_canonical_forms(
    quat: tuple[float, ...], log_scale: tuple[float, ...], norm: float
) -> None:
    quats = np.array([quat], np.float32)
    log_scales = np.array([log_scale], np.float32)
    found_scales, found_quats = canonical(log_scales, quats * np.float32(norm))
    assert (np.diff(found_scales) <= 0).all()
    assert np.linalg.norm(found_quats) == pytest.approx(1, abs=1e-12)
    assert (np.abs(found_quats[:, 1:]) <= found_quats[:, :1] + 1e-12).all()
    expected = covariances(log_scales.astype(float), quats.astype(float))
    actual = covariances(found_scales, found_quats)
    assert np.abs(actual - expected).max() <= 1e-5 * np.exp(2 * log_scales.max())


def test_multiply_is_the_product_of_quaternions() -> None:
    i, j, k = (0.0, 1.0, 0.0, 0.0), (0.0, 0.0, 1.0, 0.0), (0.0, 0.0, 0.0, 1.0)
    assert multiply(i, j) == k
    assert multiply(j, k) == i
    assert multiply(k, i) == j
    assert multiply(i, i) == (-1, 0, 0, 0)


@given(st.tuples(numbers, numbers, numbers))
def test_luma_has_an_inverse(rgb: tuple[float, ...]) -> None:
    y, co, cg = to_luma(np.array(rgb)).astype(np.float32)
    assert from_luma(y, co, cg) == pytest.approx(rgb, abs=1e-6)


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
