"""Mathematics of the times of frames: the clock that player, server and simulator share."""

from __future__ import annotations

from itertools import accumulate, pairwise

import pytest
from hypothesis import given
from hypothesis import strategies as st

from codec.errors import InvalidError
from server.abr.playout import PlayoutClock, PlayoutConfig

AT_ONCE = PlayoutConfig(start_lead_s=0, resume_lead_s=0)

gaps_s = st.lists(st.floats(0, 0.5), min_size=1, max_size=50)


@given(gaps_s, st.sampled_from([1.0, 24.0, 29.97, 60.0]), st.integers(0, 9))
def test_frames_show_in_turn_and_never_before_they_can(
    gaps_s: list[float], fps: float, first: int
) -> None:
    clock = PlayoutClock(first, fps, AT_ONCE)
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
    clock = PlayoutClock(0, 10.0, AT_ONCE)
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


def test_a_stall_ends_with_a_lead() -> None:
    clock = PlayoutClock(0, 10.0, PlayoutConfig(start_lead_s=0, resume_lead_s=0.25))
    clock.ready_until(1, 0.0)
    clock.ready_until(2, 5.0)
    clock.ready_until(3, 6.0)
    assert (clock.end_frame, clock.next_frame(7.0), clock.stalls) == (1, 1, 0)
    assert clock.stalled(7.0)
    clock.ready_until(4, 7.0)
    assert (clock.end_frame, clock.stalls) == (4, 1)
    assert clock.times_s(1) == (0.1, 7.0)
    assert clock.stalled_s == pytest.approx(6.9)
    clock.ready_until(5, 8.0)  # the stream ends there, so the clock waits for nothing more
    assert clock.stalled(8.0)
    clock.until_frame = 5
    clock.ready_until(5, 8.5)
    assert (clock.end_frame, clock.stalls) == (5, 2)


@pytest.mark.parametrize(
    ("until_frame", "plays_s", "leads_s"),
    [
        (10_000, [3, 3, 3, 3, 3], [0.1, 1, 2, 4, 4]),
        (10_000, [3, 19, 21, 3], [0.1, 1, 0.1, 1]),
        (None, [3, 3, 3, 3], [0.1, 0.1, 0.1, 0.1]),
    ],
)
def test_stalls_that_follow_each_other_wait_for_more(
    until_frame: int | None, plays_s: list[int], leads_s: list[float]
) -> None:
    config = PlayoutConfig(start_lead_s=0, longest_lead_s=4)
    clock = PlayoutClock(0, 10.0, config, until_frame)
    clock.ready_until(1, now_s := 0.0)
    found = []
    for play_s in plays_s:
        clock.ready_until(clock.next_frame(now_s) + 10 * play_s, now_s)
        now_s = clock.due_s(clock.end_frame) + 1.0
        end, stalls = clock.end_frame, clock.stalls
        while clock.stalls == stalls:
            end, now_s = end + 1, now_s + 0.1
            clock.ready_until(end, now_s)
        found.append((end - clock.next_frame(now_s)) / 10)
    assert found == leads_s


def test_who_shows_knows_better_than_a_lead() -> None:
    clock = PlayoutClock(0, 10.0, PlayoutConfig(start_lead_s=0, resume_lead_s=1.0))
    clock.ready_until(1, 0.0)
    clock.ready_until(4, 5.0)
    clock.set_next_frame(3, 5.5)
    assert (clock.end_frame, clock.next_frame(5.5)) == (4, 3)


@given(gaps_s, st.floats(0, 2))
def test_a_lead_makes_stalls_fewer_and_no_frame_earlier(
    gaps_s: list[float], resume_lead_s: float
) -> None:
    clocks = [
        PlayoutClock(0, 10.0, config, len(gaps_s))
        for config in (AT_ONCE, PlayoutConfig(start_lead_s=0, resume_lead_s=resume_lead_s))
    ]
    for frame, time_s in enumerate(accumulate(gaps_s)):
        for clock in clocks:
            clock.ready_until(frame + 1, time_s)
    at_once, leading = clocks
    assert leading.end_frame == at_once.end_frame == len(gaps_s)
    assert leading.stalls <= at_once.stalls
    for frame in range(len(gaps_s)):
        assert leading.times_s(frame)[1] >= at_once.times_s(frame)[1] - 1e-9


def test_what_is_over_does_not_stall() -> None:
    clock = PlayoutClock(0, 10.0, AT_ONCE, until_frame=2)
    clock.ready_until(2, 0.0)
    assert not clock.stalled(50.0)
    clock.until_frame = 3
    assert clock.stalled(50.0)


def test_forgotten_times_take_no_room() -> None:
    clock = PlayoutClock(0, 10.0, AT_ONCE)
    for frame in range(1000):  # each frame stalls
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
