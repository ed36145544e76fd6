"""Retries of a failing server: limited by time, not by number."""

from __future__ import annotations

from datetime import UTC, datetime
from email.utils import format_datetime
from itertools import cycle

import pytest
from hypothesis import given
from hypothesis import strategies as st

from codec.errors import InvalidError
from player.network.fetch import Retry, RetryConfig, parse_retry_after
from player.network.target import BrokenError

ERROR = BrokenError("x")


def test_tries_become_rarer() -> None:
    retry = Retry(RetryConfig(first_delay_s=0.1, max_delay_s=0.3))
    assert [retry.delay_s(ERROR, 0.0, 1.0) for _ in range(4)] == [0.1, 0.2, 0.3, 0.3]
    assert retry.delay_s(ERROR, 0.0, 0.0) == 0.15
    retry.progress()
    assert retry.delay_s(ERROR, 0.0, 1.0) == 0.1


ROUND = st.tuples(st.floats(0, 1), st.floats(0, 20), st.none() | st.floats(0, 1e9))
"""Random share, seconds that a try takes, and the wait that the server requests."""


@given(st.lists(ROUND, min_size=1), st.floats(0, 100))
def test_it_is_tried_for_as_long_as_was_said_and_no_longer(
    rounds: list[tuple[float, float, float | None]], patience_s: float
) -> None:
    retry, now_s = Retry(RetryConfig(patience_s)), 0.0

    def tries() -> None:
        nonlocal now_s
        for chance, takes_s, retry_after_s in cycle(rounds):
            now_s += retry.delay_s(BrokenError("x", retry_after_s), now_s, chance)
            assert now_s <= patience_s * (1 + 1e-12)  # it sums up the remaining times
            now_s += min(takes_s, max(0.01, patience_s - now_s))

    tried = r" \(tried for \S+ s, \d+ times\)" if patience_s else ""
    with pytest.raises(BrokenError, match=f"^x{tried}$"):
        tries()
    assert now_s >= patience_s


def test_a_server_that_asks_for_time_gets_it() -> None:
    retry = Retry(RetryConfig(60))
    assert retry.delay_s(BrokenError("x", 5.0), 0.0, 0.5) == 5.0
    # But no more than the time that is left.
    assert retry.delay_s(BrokenError("x", 3600.0), 20.0, 0.5) == 40.0
    for wrong in (-1, float("nan"), float("inf")):
        with pytest.raises(InvalidError, match="patience"):
            RetryConfig(wrong)


def test_retry_after_is_a_number_or_a_date() -> None:
    now = datetime(2024, 5, 1, 12, 0, 0, tzinfo=UTC)
    later = format_datetime(now.replace(second=7), usegmt=True)
    assert parse_retry_after("5", now.timestamp()) == 5
    assert parse_retry_after("9" * 4000, now.timestamp()) == 999_999_999
    assert parse_retry_after(later, now.timestamp()) == 7
    assert parse_retry_after(later, now.timestamp() + 60) == 0


@given(st.text())
def test_any_retry_after_is_a_time_or_nothing(text: str) -> None:
    seconds = parse_retry_after(text, 0.0)
    assert seconds is None or seconds >= 0
