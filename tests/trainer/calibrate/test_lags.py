"""Lags between series of one thing, as several observers saw or heard it."""

from __future__ import annotations

import numpy as np
import pytest

from trainer.calibrate.offsets import correlate, flash_s, lags_of, series_lags


def observed(
    rng: np.random.Generator, starts: list[float], lengths: list[int], clock: float = 0.0
) -> list[np.ndarray]:
    """Series that begin at `starts`, in samples, of one signal, louder or softer and with noise;
    the clock of the last one runs fast by `clock`."""
    signal = np.convolve(rng.gamma(0.2, 1.0, 14_000), np.hanning(9), "same")
    found = []
    for number, (start, length) in enumerate(zip(starts, lengths, strict=True)):
        steps = np.arange(length) * (1 - clock * (number == len(starts) - 1))
        seen = np.interp(start + steps, np.arange(len(signal)), signal)
        noise = rng.normal(0, seen.std(), length)
        found.append(rng.uniform(0.2, 3) * (seen + 0.5 * noise))
    return found


def test_correlation_is_one_at_the_true_shift_whatever_the_size() -> None:
    rng = np.random.default_rng(0)
    whole = rng.normal(size=300)
    shifts, alike = correlate(whole[50:250], 7 * whole[20:220])
    best = int(np.argmax(alike))
    assert shifts[best] == 30
    np.testing.assert_allclose(alike[best], np.sqrt(170 / 200), atol=0.01)
    assert -shifts.min() == 140  # an overlap of 60 of 200 is the least that counts


def test_lags_are_found_to_a_fraction_of_a_sample_with_their_spread() -> None:
    rng = np.random.default_rng(1)
    starts = [2000.0, 1500.0, 3250.5, 1.25, 900.0]
    series = observed(rng, starts, [8000, 9000, 6500, 10_000, 9500])
    found, spread, drift = series_lags(series, 20)
    lags = found.lags - found.lags[0]
    np.testing.assert_allclose(lags, starts[0] - np.array(starts), atol=0.3)
    assert (found.score > 1.5 * found.rest).all()
    assert spread.max() < 0.5
    assert np.abs(drift).max() < 1e-4


def test_a_clock_that_runs_fast_is_seen_as_drift() -> None:
    rng = np.random.default_rng(2)
    series = observed(rng, [100.0, 300.0, 500.0, 800.0], [9000] * 4, clock=1e-3)
    _, _, drift = series_lags(series, 20)
    np.testing.assert_allclose(drift[3] - drift[:3], 1e-3, atol=2e-4)


def test_a_series_of_something_else_is_not_alike() -> None:
    rng = np.random.default_rng(3)
    series = observed(rng, [100.0, 300.0, 500.0, 800.0], [9000] * 4)
    series[2] = rng.gamma(0.2, 1.0, 9000)
    found, _, _ = series_lags(series, 20)
    assert (found.score > 1.5 * found.rest).tolist() == [True, True, False, True]
    np.testing.assert_allclose(found.lags[[1, 3]] - found.lags[0], [-200, -700], atol=0.5)


def test_some_that_agree_on_a_wrong_lag_are_put_right() -> None:
    """Two groups of three, and the clearest of all pairs, between them, is wrong by 20."""
    shifts = np.arange(-50, 51)

    def curve(peak: int, height: float) -> np.ndarray:
        found: np.ndarray = height * np.exp(-(((shifts - peak) / 3) ** 2))
        return found

    curves = {
        (i, j): (shifts, curve(0, 1.0 if (i < 3) == (j < 3) else 0.6))
        for i in range(6)
        for j in range(i + 1, 6)
    }
    curves[2, 3] = shifts, curve(20, 1.5)
    found = lags_of(curves, 6, 5)
    np.testing.assert_allclose(found.lags - found.lags[0], 0, atol=0.1)


@pytest.mark.parametrize(
    ("rises", "told"),
    [
        ({}, None),
        ({41: 20.0}, 41 / 25),
        ({41: 14.0, 42: 9.0}, 41 / 25),  # half of a flash in each of two frames
        ({41: 20.0, 90: 20.0}, None),  # two: which of them do the others see?
        ({41: 3.0}, None),
    ],
)
def test_a_flash_tells_the_time_if_there_is_one(
    rises: dict[int, float], told: float | None
) -> None:
    means = np.random.default_rng(4).normal(100, 0.5, 150)
    for frame, rise in rises.items():
        means[frame : frame + 3] += rise
    assert flash_s(means, 25.0) == told
