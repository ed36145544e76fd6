"""The playout time line as mathematics."""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from codec.errors import CorruptError, InvalidError
from codec.slice import Slice
from codec.splats import Splats
from player.playout.timeline import FrameRecord, Playout, PlayoutConfig
from player.source.source import ReceivedSlice

EPSILON_S = 1e-9


def received(birth: int, layers: int = 1, wire_bytes: int = 100) -> ReceivedSlice:
    return ReceivedSlice(Slice(birth, Splats.empty(), np.zeros(0, np.uint8)), layers, wire_bytes)


def played(
    arrivals_s: list[float], first: int, swin_size: int, fps: float
) -> tuple[list[FrameRecord], Playout]:
    """Pushes a slice at each time, takes every frame as soon as there is one."""
    playout = Playout(first, swin_size, fps)
    records = []
    for birth, arrival_s in enumerate(arrivals_s, first - swin_size + 1):
        playout.push(received(birth), arrival_s)
        while due := playout.take():
            records.append(due.record)
    return records, playout


gaps_s = st.lists(st.floats(0, 0.5), min_size=1, max_size=60)
windows = st.integers(1, 6)
rates = st.sampled_from([1.0, 24.0, 29.97, 60.0])


@given(gaps_s, windows, rates, st.integers(0, 9))
def test_no_frame_shows_before_its_window_or_out_of_turn(
    gaps_s: list[float], swin_size: int, fps: float, first: int
) -> None:
    arrivals_s = list(itertools.accumulate(gaps_s))
    records, _ = played(arrivals_s, first, swin_size, fps)
    assert [r.frame for r in records] == list(
        range(first, first + max(0, len(arrivals_s) - swin_size + 1))
    )
    for record, complete_s in zip(records, arrivals_s[swin_size - 1 :], strict=True):
        assert record.shown_s >= complete_s
        assert record.shown_s >= record.due_s
        # Either on time, or at the very moment when the last slice came.
        assert record.shown_s == (complete_s if record.late else record.due_s)
    for before, after in itertools.pairwise(records):
        assert after.due_s == pytest.approx(before.shown_s + 1 / fps, abs=EPSILON_S)


@given(gaps_s, windows, rates)
def test_startup_play_and_stalls_add_up_to_the_time_that_passed(
    gaps_s: list[float], swin_size: int, fps: float
) -> None:
    records, playout = played(list(itertools.accumulate(gaps_s)), 0, swin_size, fps)
    totals = playout.totals
    assert totals.frames == len(records)
    assert totals.stalls == sum(r.late for r in records)
    assert totals.stalled_s == pytest.approx(sum(r.shown_s - r.due_s for r in records))
    if records:
        assert not records[0].late
        passed_s = totals.startup_s + (len(records) - 1) / fps + totals.stalled_s
        assert records[-1].shown_s == pytest.approx(passed_s, abs=1e-6)
    assert totals.wire_bytes == sum(r.wire_bytes for r in records)


@given(windows, st.integers(1, 12), st.lists(st.booleans(), max_size=200))
def test_the_queue_is_bounded_and_never_stuck(
    swin_size: int, max_frames: int, pushes: list[bool]
) -> None:
    playout = Playout(0, swin_size, 30, PlayoutConfig(max_frames=max_frames))
    for push in pushes:
        if push and playout.has_room:
            playout.push(received(playout.next_birth), 0.0)
        elif not push:
            playout.take()
        assert 0 <= playout.frames_waiting <= max_frames
        assert playout.has_room or playout.next_shown_s is not None
    assert playout.totals.most_frames_waiting <= max_frames


def test_a_full_queue_refuses_and_counts_bytes() -> None:
    splats = Splats(*(np.ones(s, np.float32) for s in ((9, 3), (9, 3), (9, 4), (9,), (9, 1, 3))))
    slices = [ReceivedSlice(Slice(b, splats, np.zeros(9, np.uint8)), 1, 7) for b in range(3)]
    one_bytes = slices[0].memory_bytes
    assert one_bytes == 9 * (4 * (3 + 3 + 4 + 1 + 3) + 1)
    playout = Playout(0, 1, 30, PlayoutConfig(max_bytes=2 * one_bytes))
    playout.push(slices[0], 0.0)
    playout.push(slices[1], 0.0)
    assert playout.totals.most_bytes_waiting == 2 * one_bytes
    assert not playout.has_room
    with pytest.raises(InvalidError, match="full"):
        playout.push(slices[2], 0.0)
    assert playout.take() is not None
    assert playout.has_room


def test_a_window_fits_whatever_the_bounds() -> None:
    playout = Playout(5, 10, 30, PlayoutConfig(max_frames=1, max_bytes=1))
    for birth in range(-4, 6):
        assert playout.take() is None
        playout.push(received(birth), 1.0)
    due = playout.take()
    assert due is not None
    assert [s.birth for s in due.slices] == list(range(-4, 6))


def test_frames_come_only_when_they_are_due() -> None:
    playout = Playout(0, 2, 10)
    playout.push(received(-1), 1.0)
    assert playout.next_shown_s is None
    playout.push(received(0, layers=3), 2.0)
    playout.push(received(1), 2.0)
    assert playout.take(1.9) is None
    first = playout.take(2.0)
    assert first is not None
    assert first.record == FrameRecord(0, 3, 200, 2.0, 2.0)
    assert playout.next_shown_s == pytest.approx(2.1)
    assert playout.take(2.05) is None
    second = playout.take(2.1 + EPSILON_S)
    assert second is not None
    assert [s.birth for s in second.slices] == [1]
    playout.push(received(2), 3.0)  # due at 2.2
    assert playout.next_shown_s == 3.0
    late = playout.take(math.inf)
    assert late is not None
    assert late.record.late
    assert playout.totals.stalls == 1
    assert playout.totals.stalled_s == pytest.approx(0.8)
    assert playout.totals.mean_layers == pytest.approx(5 / 3)


def test_another_slice_than_the_next_one_is_an_error() -> None:
    playout = Playout(0, 3, 30)
    with pytest.raises(CorruptError, match="born at 0 where -2 belongs"):
        playout.push(received(0), 0.0)


@settings(max_examples=20)
@given(st.integers(-5, -1))
def test_there_is_no_frame_before_the_first(first: int) -> None:
    with pytest.raises(InvalidError):
        Playout(first, 1, 30)
