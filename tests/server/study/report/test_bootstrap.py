"""The bootstrap, compared with its known properties."""

from __future__ import annotations

import pytest
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


@pytest.mark.parametrize(
    ("values", "resamples", "level"), [([], 10, 0.95), ([1.0], 0, 0.95), ([1.0], 10, 1.0)]
)
def test_nothing_to_draw_from_is_refused(values: list[float], resamples: int, level: float) -> None:
    with pytest.raises(InvalidError, match="bootstrap"):
        mean_interval(values, 0, resamples, level)
