"""The syntax of a frame or a time."""

from __future__ import annotations

from contextlib import suppress

import pytest
from hypothesis import given
from hypothesis import strategies as st

from codec.errors import InvalidError
from player.view.moment import Moment


@given(st.integers(0, 10**6), st.sampled_from([10.0, 12.5, 24.0, 25.0, 30.0, 29.97, 60.0]))
def test_the_time_at_which_a_frame_begins_is_its_own(frame: int, fps: float) -> None:
    assert Moment.parse(f"{frame / fps:.9f}s").of(fps) == frame
    assert Moment.parse(f"{(frame + 0.5) / fps:.9f}s").of(fps) == frame


@given(st.integers(0, 10**17), st.floats(1, 100))
def test_a_frame_is_itself_whatever_the_rate(frame: int, fps: float) -> None:
    moment = Moment.parse(str(frame))
    assert moment.of(fps) == frame
    assert Moment.parse(str(moment)) == moment


@pytest.mark.parametrize(
    ("text", "time_s"), [("2.5s", 2.5), ("0s", 0.0), (".25s", 0.25), ("3.s", 3)]
)
def test_times(text: str, time_s: float) -> None:
    moment = Moment.parse(text)
    assert moment == Moment(time_s=time_s)
    assert Moment.parse(str(moment)) == moment


@given(st.text(max_size=30))
def test_any_text_is_a_moment_or_an_error(text: str) -> None:
    with suppress(InvalidError):
        assert Moment.parse(text).of(30.0) >= 0


@pytest.mark.parametrize("text", ["", "-1", "1.5", "s", "-2s", "nan", "1e3s", "9" * 30, "\u0661"])
def test_what_is_neither_is_refused(text: str) -> None:
    with pytest.raises(InvalidError):
        Moment.parse(text)
