"""The pictures of a film: all of them, each at its time, for any rates."""

from __future__ import annotations

from fractions import Fraction

import pytest
from hypothesis import given
from hypothesis import strategies as st

from codec.errors import InvalidError
from player.playout.clock import OutputTimes, Picture, Smoothing, exact_rate

RATES = st.sampled_from([1.0, 10.0, 23.976, 24.0, 25.0, 29.97, 30.0, 50.0, 60.0, 120.0, 999.0])


def test_rates_are_those_of_films() -> None:
    assert exact_rate(30000 / 1001) == exact_rate(29.97002997) == Fraction(30000, 1001)
    assert exact_rate(29.97) == Fraction(2997, 100)
    for fps in (0.0, -1.0, 1001.0, float("nan"), float("inf")):
        with pytest.raises(InvalidError, match="fps"):
            OutputTimes(30.0, fps, True)


def drawn(
    stream_fps: float, fps: float, interpolates: bool, plays: list[int]
) -> list[tuple[int, Picture]]:
    """Pictures of plays with these numbers of frames, each with the frame uploaded for it."""
    times, found, frame = OutputTimes(stream_fps, fps, interpolates), list[tuple[int, Picture]](), 0
    for count in plays:
        for _ in range(count):
            found += [(frame, picture) for picture in times.with_frame(frame)]
            frame += 1
        found += [(frame - 1, picture) for picture in times.behind(frame - 1)]
    assert len(found) == times.count(sum(plays))
    return found


@given(RATES, RATES, st.booleans(), st.lists(st.integers(1, 9), min_size=1, max_size=3))
def test_each_picture_is_drawn_once_at_its_time(
    stream_fps: float, fps: float, interpolates: bool, plays: list[int]
) -> None:
    found = drawn(stream_fps, fps, interpolates, plays)
    assert [picture.number for _, picture in found] == list(range(len(found)))
    ends = {sum(plays[: n + 1]) - 1 for n in range(len(plays))}
    for frame, picture in found:
        assert picture.position == picture.number * exact_rate(stream_fps) / exact_rate(fps)
        shown = frame - 1 + picture.share
        if interpolates and not (frame in ends and picture.position > frame):
            assert 0 < picture.share <= 1
            assert shown == pytest.approx(float(picture.position), abs=1e-9)
        else:  # the previous frame stays
            assert picture.share == 1
            assert frame == picture.position // 1
    after_last = Fraction(len(found)) * exact_rate(stream_fps) / exact_rate(fps)
    assert after_last >= sum(plays)


def test_nothing_is_drawn_between_frames_that_come_as_fast_as_pictures() -> None:
    smoothing = Smoothing(True, 59.94)
    for hz in (30.0, 15.0, 60.0, 59.94, 120.0):
        assert smoothing.shows_between(hz) == (hz < 59)
    smoothing.on = False
    assert not smoothing.shows_between(30.0)
