"""The bootstrap, compared with its known properties."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.stats import binom

from codec.errors import InvalidError
from server.study.report.bootstrap import mean_interval


@pytest.mark.parametrize(("ones", "zeros"), [(5, 5), (3, 17), (30, 10)])
def test_the_mean_of_coins_is_binomial(ones: int, zeros: int) -> None:
    count = ones + zeros
    interval = mean_interval([1.0] * ones + [0.0] * zeros, seed=1)
    assert interval.mean == ones / count
    # With 10,000 draws the share below a point is accurate to about a percent; the points are
    # 1 / count apart.
    low, high = binom.ppf([0.015, 0.035], count, ones / count) / count
    assert low <= interval.low <= high
    low, high = binom.ppf([0.965, 0.985], count, ones / count) / count
    assert low <= interval.high <= high


@given(st.lists(st.floats(-50, 50), min_size=1, max_size=20), st.integers(0, 1000))
def test_an_interval_moves_with_its_values(values: list[float], seed: int) -> None:
    interval = mean_interval(values, seed, resamples=200)
    assert min(values) - 1e-9 <= interval.low <= interval.high <= max(values) + 1e-9
    moved = mean_interval([2 * value + 1 for value in values], seed, resamples=200)
    assert moved.mean == pytest.approx(2 * interval.mean + 1)
    assert moved.low == pytest.approx(2 * interval.low + 1)
    assert moved.high == pytest.approx(2 * interval.high + 1)


@pytest.mark.parametrize(
    ("values", "resamples", "level"), [([], 10, 0.95), ([1.0], 0, 0.95), ([1.0], 10, 1.0)]
)
def test_nothing_to_draw_from_is_refused(values: list[float], resamples: int, level: float) -> None:
    with pytest.raises(InvalidError, match="bootstrap"):
        mean_interval(values, 0, resamples, level)
