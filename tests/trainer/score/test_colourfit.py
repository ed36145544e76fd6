"""Mathematics of a picture in a camera's colours."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from trainer.score.colourfit import colour_fitted
from trainer.score.picture import Floats
from trainer.step.loss import psnr_db

colours = st.tuples(st.floats(0.5, 1.5), st.floats(-0.2, 0.2))


def picture(seed: int) -> Floats:
    return np.random.default_rng(seed).random((6, 7, 3), np.float32)


@given(st.integers(0, 99), st.tuples(colours, colours, colours))
def test_a_camera_with_other_colours_costs_nothing(
    seed: int, cast: tuple[tuple[float, float], ...]
) -> None:
    shown = picture(seed)
    gain_bias = np.array(cast, np.float32)
    truth: Floats = gain_bias[:, 0] * shown + gain_bias[:, 1]
    assert colour_fitted(shown, truth) == pytest.approx(truth, abs=1e-5)


@given(st.integers(0, 99))
def test_no_other_colours_fit_better(seed: int) -> None:
    shown, truth = picture(seed), picture(seed + 100)
    best = psnr_db(colour_fitted(shown, truth), truth)
    assert best >= psnr_db(shown, truth)
    rng = np.random.default_rng(seed)
    for _ in range(5):
        gain, bias = rng.normal(1, 0.3, 3), rng.normal(0, 0.1, 3)
        assert best >= psnr_db((gain * shown + bias).astype(np.float32), truth) - 1e-6


def test_what_a_mask_ignores_does_not_count() -> None:
    shown = picture(0)
    truth: Floats = np.float32(0.5) * shown + np.float32(0.1)
    mask = np.ones((6, 7), np.uint8)
    mask[:, 4:] = 0
    other = truth.copy()
    other[:, 4:] = 1
    assert (colour_fitted(shown, other, mask) == colour_fitted(shown, truth, mask)).all()
    assert colour_fitted(shown, other, np.zeros((6, 7), np.uint8)) is shown


def test_a_channel_of_one_value_is_only_moved() -> None:
    shown, truth = np.full((4, 4, 3), 0.25, np.float32), picture(1)[:4, :4]
    expected = np.broadcast_to(truth.mean(axis=(0, 1)), truth.shape)
    assert colour_fitted(shown, truth) == pytest.approx(expected, abs=1e-6)
