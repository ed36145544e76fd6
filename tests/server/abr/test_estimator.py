"""Mathematics of the estimate of a link."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from codec.errors import InvalidError
from server.abr.estimator import EstimatorConfig, RateEstimator

samples = st.lists(
    st.tuples(st.integers(0, 200_000), st.floats(1e-3, 0.5)), min_size=1, max_size=80
)


@given(samples)
def test_it_lies_between_the_slowest_and_the_fastest_of_what_it_heard(
    heard: list[tuple[int, float]],
) -> None:
    estimator = RateEstimator(EstimatorConfig(sample_s=1e-3))
    for num_bytes, busy_s in heard:
        estimator.add(num_bytes, busy_s)
    if estimator.rate_bps is None:
        return
    rates = [8 * num_bytes / busy_s for num_bytes, busy_s in heard]
    assert min(rates) * (1 - 1e-9) <= max(1.0, estimator.rate_bps)
    assert estimator.rate_bps <= max(*rates, 1.0) * (1 + 1e-9) + 1


@pytest.mark.parametrize("before", [0.3e6, 4e6, 100e6])
@pytest.mark.parametrize("times", [0.25, 4.0])
def test_a_change_is_known_after_one_window(before: float, times: float) -> None:
    config = EstimatorConfig()
    estimator = RateEstimator(config)
    for _ in range(100):
        estimator.add(before * 0.01 / 8, 0.01)
    assert estimator.rate_bps == pytest.approx(before)
    heard_bytes = heard_s = 0.0
    while heard_s < config.window_s + 0.03 or heard_bytes < config.min_bytes + 1000:
        estimator.add(times * before * 0.01 / 8, 0.01)
        heard_s += 0.01
        heard_bytes += times * before * 0.01 / 8
    assert estimator.rate_bps == pytest.approx(times * before, rel=0.02)


def test_there_is_none_before_there_are_bytes_to_go_by() -> None:
    estimator = RateEstimator()
    estimator.add(8_000, 0.5)
    assert estimator.rate_bps is None
    estimator.add(12_000, 0.5)
    assert estimator.rate_bps == pytest.approx(160_000)


def test_a_link_that_is_silent_is_slow_but_never_nothing() -> None:
    estimator = RateEstimator()
    estimator.add(100_000, 0.1)
    for _ in range(1000):
        estimator.add(0, 0.1)
    assert estimator.rate_bps == 1.0


@pytest.mark.parametrize("name", ["window_s", "sample_s", "min_bytes"])
def test_settings_that_cannot_work_are_refused(name: str) -> None:
    with pytest.raises(InvalidError, match=name):
        EstimatorConfig(**{name: 0})
