"""When frames show, as mathematics: the clock that player, server and simulator share."""

from __future__ import annotations

from itertools import accumulate, pairwise

import pytest
from hypothesis import given
from hypothesis import strategies as st

from codec.errors import InvalidError
from server.abr.playout import PlayoutClock, PlayoutConfig

gaps_s = st.lists(st.floats(0, 0.5), min_size=1, max_size=50)


@given(gaps_s, st.sampled_from([1.0, 24.0, 29.97, 60.0]), st.integers(0, 9))
def test_frames_show_in_turn_and_never_before_they_can(
    gaps_s: list[float], fps: float, first: int
) -> None:
    clock = PlayoutClock(first, fps, PlayoutConfig(start_lead_s=0))
    came_s = list(accumulate(gaps_s))
    for frame, time_s in enumerate(came_s, first):
        clock.ready_until(frame + 1, time_s)
    times = [clock.times_s(frame) for frame in range(first, first + len(came_s))]
    for (due_s, shown_s), time_s in zip(times, came_s, strict=True):
        assert shown_s >= max(due_s, time_s) - 1e-9
    for (_, before_s), (due_s, _) in pairwise(times):
        assert due_s == pytest.approx(before_s + 1 / fps)
    late_s = [shown_s - due_s for due_s, shown_s in times]
    assert clock.stalled_s == pytest.approx(sum(late_s), abs=1e-6)
    assert clock.stalls == sum(late > 1e-9 for late in late_s)


@given(gaps_s, st.floats(0, 30))
def test_the_next_frame_is_the_first_that_has_not_shown(gaps_s: list[float], now_s: float) -> None:
    clock = PlayoutClock(0, 10.0, PlayoutConfig(start_lead_s=0))
    for frame, time_s in enumerate(accumulate(gaps_s)):
        if time_s > now_s:
            break
        clock.ready_until(frame + 1, time_s)
    if clock.started_s is None:
        assert clock.next_frame(now_s) == 0
        return
    frame = clock.next_frame(now_s)
    assert all(clock.times_s(n)[1] < now_s + 1e-6 for n in range(frame))
    assert frame == clock.end_frame or clock.times_s(frame)[1] >= now_s - 1e-6
    assert clock.stalled(now_s) == (frame == clock.end_frame and clock.due_s(frame) < now_s - 1e-9)


def test_play_begins_with_a_lead() -> None:
    clock = PlayoutClock(0, 10.0, PlayoutConfig(start_lead_s=0.25))
    clock.ready_until(2, 1.0)
    assert clock.started_s is None
    clock.ready_until(3, 2.0)
    assert clock.started_s == 2.0
    short = PlayoutClock(0, 10.0, PlayoutConfig(start_lead_s=5.0), until_frame=2)
    short.ready_until(2, 1.0)
    assert short.started_s == 1.0


def test_what_is_over_does_not_stall() -> None:
    clock = PlayoutClock(0, 10.0, PlayoutConfig(start_lead_s=0), until_frame=2)
    clock.ready_until(2, 0.0)
    assert not clock.stalled(50.0)
    clock.until_frame = 3
    assert clock.stalled(50.0)


def test_forgotten_times_take_no_room() -> None:
    clock = PlayoutClock(0, 10.0, PlayoutConfig(start_lead_s=0))
    for frame in range(1000):  # each one stalls
        clock.ready_until(frame + 1, 1.0 + frame)
        clock.forget(frame)
        assert len(clock._bases) <= 3
    due_s, shown_s = clock.times_s(999)
    assert due_s == pytest.approx(999.1)
    assert shown_s == 1000.0


@pytest.mark.parametrize(("first", "fps"), [(-1, 30.0), (0, 0.0), (0, float("nan"))])
def test_there_is_no_such_playback(first: int, fps: float) -> None:
    with pytest.raises(InvalidError):
        PlayoutClock(first, fps)
