"""Targets of seeking, skipping and looping, and behaviour at the end."""

from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from codec.errors import InvalidError
from player.playout.timeline import Transport, next_rate

frames = st.integers(-(10**9), 10**9)


@given(st.integers(0, 1000), st.integers(1, 1000), frames, st.floats(-1e6, 1e6))
def test_one_stays_within_the_frames(first: int, count: int, frame: int, seconds: float) -> None:
    transport = Transport(first, first + count, 30.0)
    assert first <= transport.seek(frame) < first + count
    assert first <= transport.skip(seconds) < first + count
    if first <= frame < first + count:
        assert transport.seek(frame) == frame


def test_a_live_stream_ends_where_it_has_come_to() -> None:
    transport = Transport(0, None, 30.0, known_end=300, shown=10)
    assert transport.seek(10**6) == 299
    assert transport.newest == 269
    assert not transport.at_end
    transport.known_end = 20
    assert transport.newest == 0


def test_the_end_is_the_last_frame_and_a_loop_ends_when_it_is_asked_to() -> None:
    transport = Transport(5, 10, 30.0, plays_left=2)
    assert transport.newest == 9
    for shown, at_end in ((None, False), (8, False), (9, True)):
        transport.shown = shown or transport.shown
        assert transport.at_end == at_end
    assert transport.loops
    transport.plays_left -= 1
    assert not transport.loops
    assert transport.toggle_loop()
    assert transport.plays_left == math.inf
    assert not transport.toggle_loop()
    with pytest.raises(InvalidError, match="5:5"):
        Transport(5, 5, 30.0)


def test_rates_go_up_and_down_a_ladder() -> None:
    found = [next_rate(*step) for step in ((1.0, 1), (1.0, -2), (4.0, 1), (0.3, 0), (0.1, -1))]
    assert found == [1.5, 0.25, 4.0, 0.25, 0.1]
