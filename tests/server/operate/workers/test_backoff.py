"""When a worker that died is started again."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from codec.errors import InvalidError
from server.operate.workers.backoff import Backoff, BackoffConfig

CONFIG = BackoffConfig()


def test_the_first_restart_is_at_once_and_each_further_one_waits_twice_as_long() -> None:
    backoff = Backoff(CONFIG, lambda: 0.5)
    waits_s = [backoff.died(0.01) for _ in range(10)]
    assert waits_s == pytest.approx([0, 0.1, 0.2, 0.4, 0.8, 1.6, 3.2, 6.4, 10, 10])


def test_one_that_lived_long_enough_is_forgiven() -> None:
    backoff = Backoff(CONFIG, lambda: 0.5)
    for _ in range(5):
        backoff.died(0.01)
    assert backoff.died(CONFIG.settle_s) == 0
    assert backoff.died(0.01) == pytest.approx(0.1)


@given(st.lists(st.tuples(st.floats(0, 20), st.floats(0, 1)), max_size=200))
def test_no_wait_is_longer_than_the_longest(deaths: list[tuple[float, float]]) -> None:
    for lived_s, number in deaths:
        assert 0 <= Backoff(CONFIG, lambda number=number: number).died(lived_s) <= CONFIG.max_s  # type: ignore[misc]
    numbers = iter(number for _, number in deaths)
    backoff = Backoff(CONFIG, lambda: next(numbers))
    assert all(0 <= backoff.died(lived_s) <= CONFIG.max_s for lived_s, _ in deaths)


def test_a_thousand_deaths_do_not_overflow() -> None:
    backoff = Backoff(CONFIG, lambda: 1.0)
    assert [backoff.died(0.0) for _ in range(1000)][-1] == CONFIG.max_s


@pytest.mark.parametrize(
    "wrong", [{"first_s": 0.0}, {"first_s": 20.0}, {"max_s": float("inf")}, {"settle_s": 0.0}]
)
def test_a_config_that_makes_no_sense_is_refused(wrong: dict[str, float]) -> None:
    with pytest.raises(InvalidError, match=next(iter(wrong))):
        BackoffConfig(**wrong)
