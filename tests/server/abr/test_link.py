"""Links as numbers: conversion of times to bytes and back."""

from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from codec.errors import InvalidError
from server.abr.link import Link, LinkStep

links = st.lists(
    st.builds(
        LinkStep,
        st.floats(0.01, 5),
        st.one_of(st.just(0.0), st.floats(1e3, 1e8)),
        st.floats(0, 0.2),
    ),
    min_size=1,
    max_size=6,
).filter(lambda s: any(step.rate_bps for step in s)).map(Link)  # fmt: skip


def bits_between(link: Link, start_s: float, end_s: float) -> float:
    """Bits that the link passes from `start_s` to `end_s`, summed up step by step."""
    total, at_s, n = 0.0, 0.0, 0
    while at_s < end_s:
        step = link.steps[n % len(link.steps)]
        over_s = min(end_s, at_s + step.duration_s) - max(start_s, at_s)
        total += step.rate_bps * max(0.0, over_s)
        at_s += step.duration_s
        n += 1
    return total


@given(links, st.floats(0, 20), st.integers(0, 100_000))
def test_bytes_take_as_long_as_the_steps_say(link: Link, start_s: float, num_bytes: int) -> None:
    # At most a few rounds of the trace, because the sum above is slow.
    num_bytes = min(num_bytes, int(bits_between(link, start_s, start_s + 100) / 8))
    end_s = link.passed_s(start_s, num_bytes)
    assert end_s >= start_s
    assert bits_between(link, start_s, end_s) == pytest.approx(8 * num_bytes, rel=1e-6, abs=20)


@given(links, st.floats(0, 20), st.floats(0, 20))
def test_the_capacity_is_the_sum_over_the_steps(link: Link, start_s: float, end_s: float) -> None:
    bits = bits_between(link, start_s, end_s)
    assert 8 * link.capacity_bytes(start_s, end_s) == pytest.approx(bits, rel=1e-6, abs=20)


@given(st.integers(1, 10**6), st.booleans())
def test_whole_rounds_end_before_the_silence(rounds: int, silent_first: bool) -> None:
    """The end is exact for any number of rounds: one more bit would wait for the silence."""
    loud, silent = LinkStep(0.5, 2e6, 0.0), LinkStep(0.25, 0.0, 0.0)
    link = Link([silent, loud] if silent_first else [loud, silent])
    end_s = 0.75 * rounds - (0 if silent_first else 0.25)
    assert link.passed_s(0, 125_000 * rounds) == end_s
    assert link.capacity_bytes(0, end_s) == 125_000 * rounds
    assert link.passed_s(0, 125_000 * rounds + 1) == pytest.approx(end_s + 0.25 + 4e-6, abs=1e-9)


def test_nothing_passes_at_once_even_in_silence() -> None:
    link = Link([LinkStep(1, 0, 0), LinkStep(1, 8e3, 0)])
    assert link.passed_s(0.5, 0) == 0.5
    assert link.passed_s(0.5, 1) == pytest.approx(1.001)
    assert link.passed_s(0.5, 1000) == 2
    assert link.passed_s(0.5, 1001) == pytest.approx(3.001)


def test_a_step_holds_from_its_beginning_to_before_its_end() -> None:
    steps = [LinkStep(1, 8, 0), LinkStep(2, 16, 0.1)]
    link = Link(steps)
    assert [link.at(time_s) for time_s in (0, 0.9, 1, 2.9, 3, 3.9, 4)] == [
        steps[n] for n in (0, 0, 1, 1, 0, 0, 1)
    ]
    assert (link.round_s, link.mean_bps) == (3, 40 / 3)


@pytest.mark.parametrize(
    ("steps", "message"),
    [
        ([], "every rate is 0"),
        ([(1, 0, 0)], "every rate is 0"),
        ([(1, 1e-3, 0)], "less than one bit"),
        ([(1, 8, 0), (0, 8, 0)], "step 1 is"),
        ([(-1, 8, 0)], "step 0 is"),
        ([(1, -8, 0)], "step 0 is"),
        ([(1, 8, -1)], "step 0 is"),
        ([(1, math.nan, 0)], "step 0 is"),
        ([(math.inf, 8, 0)], "step 0 is"),
        ([(1e200, 1e200, 0)], "too large"),
        ([(1e308, 1e-308, 0), (1e308, 1e-308, 0)], "too large"),
    ],
)
def test_what_is_not_a_link(steps: list[tuple[float, float, float]], message: str) -> None:
    with pytest.raises(InvalidError, match=message):
        Link([LinkStep(*step) for step in steps])
