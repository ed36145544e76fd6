"""Bytes that have passed a link, and their times of arrival."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from server.abr.link.link import Link, LinkStep
from server.study.oracle.passage import Passage
from tests.server.study.oracle.made_up_streams import make_link

seeds = st.integers(0, 1 << 32)


@given(seed=seeds, num_bytes=st.integers(1, 10_000_000))
@settings(max_examples=100, deadline=None)
def test_it_is_the_link_from_time_0(seed: int, num_bytes: int) -> None:
    link = make_link(np.random.default_rng(seed), 1e6)
    passage = Passage(link)
    earliest_s = passage.earliest_s(num_bytes)
    assert earliest_s == pytest.approx(link.passed_s(0.0, num_bytes), abs=1e-6)
    assert passage.bytes_by(earliest_s) == pytest.approx(num_bytes, abs=1)
    latest_s = passage.latest_s(num_bytes)
    assert latest_s >= earliest_s - 1e-6
    assert passage.bytes_by(latest_s) == pytest.approx(num_bytes, abs=1)
    assert passage.bytes_by(latest_s + 1e-3) > num_bytes


@given(seed=seeds, time_s=st.floats(0, 100))
@settings(max_examples=100, deadline=None)
def test_nothing_comes_sooner_or_passes_later_than_it_says(seed: int, time_s: float) -> None:
    rng = np.random.default_rng(seed)
    link = make_link(rng, 1e6)
    passage = Passage(link)
    later_s = time_s + rng.exponential(0.5, 50)
    assert all(s + link.at(s).latency_s >= passage.comes_s(time_s) - 1e-9 for s in later_s)
    passed_s = passage.passed_s(time_s)
    after_s = passed_s + 1e-6 + rng.exponential(0.2, 50)
    assert all(s + link.at(s).latency_s > time_s for s in after_s if s >= 0)
    if passed_s >= 0:
        assert passage.comes_s(passed_s - 1e-6) <= time_s + 1e-6


def test_outages_are_spans_of_time_without_bytes() -> None:
    passage = Passage(Link([LinkStep(2.0, 0.0, 0.0), LinkStep(1.0, 8000.0, 0.0)]))
    assert passage.latest_s(0) == 2.0
    assert passage.earliest_s(1000) == 3.0
    assert passage.latest_s(1000) == 5.0
    assert passage.latest_s(-1.0) < 0
    assert [passage.bytes_by(s) for s in (-1.0, 2.0, 2.5, 4.0, 5.5)] == [0, 0, 500, 1000, 1500]


def test_a_shorter_latency_overtakes() -> None:
    passage = Passage(Link([LinkStep(1.0, 8000.0, 0.5), LinkStep(1.0, 8000.0, 0.1)]))
    assert passage.comes_s(0.2) == pytest.approx(0.7)
    assert passage.comes_s(0.9) == pytest.approx(1.1)
    assert passage.passed_s(1.05) == pytest.approx(0.55)
    assert passage.passed_s(1.2) == pytest.approx(1.1)
