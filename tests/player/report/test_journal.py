"""Contents of a report: bounded, with correct sums."""

from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from player.report.journal import STEPS_PER_S, WINDOW_STEPS, Journal, Rows
from server.abr.link import Link, LinkStep


@given(st.lists(st.integers()), st.integers(0, 5))
def test_the_newest_rows_stay_and_the_others_are_counted(values: list[int], most: int) -> None:
    rows: Rows[int] = Rows(most)
    for value in values:
        rows.add(value)
    assert rows.all() == values[max(0, len(values) - most) :]
    assert rows.dropped == max(0, len(values) - most)
    assert rows.last == (rows.all()[-1] if rows.all() else None)


@given(st.lists(st.tuples(st.floats(0, 1.5), st.integers(1, 10**6)), min_size=1, max_size=30))
def test_each_byte_counts_in_the_goodput_of_half_a_second(gaps: list[tuple[float, int]]) -> None:
    journal, now_s, total = Journal(), 0.0, 0
    for gap_s, num_bytes in gaps:
        now_s += gap_s
        total += num_bytes
        journal.received(num_bytes, now_s, now_s + 100)
    rates = journal.rates(None, None)
    assert rates[-1].time_s == pytest.approx(math.floor(now_s * STEPS_PER_S) / 10 + 0.1)
    # A pause of any length has rates, too: 0.
    assert len(rates) == round((rates[-1].time_s - rates[0].time_s) * STEPS_PER_S) + 1
    # Every byte is in WINDOW_STEPS moments, but the last bytes have no later moments yet.
    told = sum(one.goodput_bps for one in rates) / 8 / STEPS_PER_S
    assert told <= total + 1e-6
    assert rates[0].goodput_bps > 0
    assert all(one.link_bps is None for one in rates)


def test_a_constant_stream_reads_as_its_rate_and_the_link_as_it_was() -> None:
    link = Link([LinkStep(2, 8e6, 0.0), LinkStep(2, 1e6, 0.0)])
    journal = Journal()
    for n in range(400):
        journal.received(1000, n / 100, 50 + n / 100)
    rates = journal.rates(link, link_began_s=50.0)
    assert {one.goodput_bps for one in rates[WINDOW_STEPS:]} == {8e5}
    assert [one.link_bps for one in rates[:19]] == [8e6] * 19
    assert [one.link_bps for one in rates[20:39]] == [1e6] * 19
