"""Mathematics of the playout time line."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from codec.errors import InvalidError
from codec.stream.manifest import Part
from player.playout.timeline import FrameRecord, Playout, QueueConfig
from player.source.source import KeyframePackets, Packets, SlicePackets
from server.abr.playout import PlayoutConfig
from tests.support.hosted_streams import small_manifest

EPSILON_S = 1e-9
AT_ONCE = PlayoutConfig(start_lead_s=0, resume_lead_s=0)


def blame(error: Exception, part: Part) -> Exception:
    raise AssertionError("nothing is decoded here")


def packets(birth: int, first: int = 0, end: int = 1, size: int = 100) -> SlicePackets:
    each = (bytes(size // (end - first)),) * (end - first)
    return SlicePackets(birth, first, each, None, blame)  # type: ignore[arg-type]


def keyframes(frame: int, first: int = 0, end: int = 1) -> KeyframePackets:
    return KeyframePackets(frame, first, packets(0, first, end).packets, blame)  # type: ignore[arg-type]


def sent(first: int, segment_frames: int) -> Iterator[Packets]:
    """Layer 0 of a play from frame `first` on: the keyframe of its segment, then slices."""
    start = first - first % segment_frames
    yield keyframes(start)
    for birth in itertools.count(start + 1):
        yield packets(birth)


def playout_of(segment_frames: int, fps: float, first: int = 0, **more: Any) -> Playout:
    manifest = small_manifest(4, 0, fps, segment_frames=segment_frames)
    return Playout(manifest, first, **{"config": AT_ONCE, **more})


def played(
    arrivals_s: list[float], first: int, segment_frames: int, fps: float
) -> tuple[list[FrameRecord], Playout]:
    """Pushes packets at each time, and takes every frame as soon as it is due."""
    playout = playout_of(segment_frames, fps, first)
    records = []
    for arrival_s, one in zip(arrivals_s, sent(first, segment_frames), strict=False):
        playout.push(one, arrival_s)
        while due := playout.pop_due():
            records.append(due.record)
    return records, playout


gaps_s = st.lists(st.floats(0, 0.5), min_size=1, max_size=60)
lengths = st.integers(1, 6)
rates = st.sampled_from([1.0, 24.0, 29.97, 60.0])


@given(gaps_s, lengths, rates, st.integers(0, 9))
def test_no_frame_shows_before_its_slices_or_out_of_turn(
    gaps_s: list[float], segment_frames: int, fps: float, first: int
) -> None:
    arrivals_s = list(itertools.accumulate(gaps_s))
    records, _ = played(arrivals_s, first, segment_frames, fps)
    complete = arrivals_s[first % segment_frames :]
    assert [r.frame for r in records] == list(range(first, first + len(complete)))
    for record, complete_s in zip(records, complete, strict=True):
        assert record.shown_s >= complete_s - EPSILON_S
        # Either on time, or at the moment when the last slice arrived.
        assert record.shown_s == (complete_s if record.late else record.due_s)
    for before, after in itertools.pairwise(records):
        assert after.due_s == pytest.approx(before.shown_s + 1 / fps, abs=EPSILON_S)


@given(gaps_s, lengths, rates)
def test_startup_play_and_stalls_add_up_to_the_time_that_passed(
    gaps_s: list[float], segment_frames: int, fps: float
) -> None:
    records, playout = played(list(itertools.accumulate(gaps_s)), 5, segment_frames, fps)
    totals = playout.totals
    assert totals.frames == len(records)
    assert totals.stalls == sum(r.late for r in records)
    assert totals.stalled_s == pytest.approx(sum(r.shown_s - r.due_s for r in records))
    if records:
        assert not records[0].late
        passed_s = totals.startup_s + (len(records) - 1) / fps + totals.stalled_s
        assert records[-1].shown_s == pytest.approx(passed_s, abs=1e-6)
    assert totals.wire_bytes == sum(r.wire_bytes for r in records)


@given(lengths, st.integers(1, 12), st.lists(st.booleans(), max_size=200))
def test_the_queue_is_bounded_and_never_stuck(
    segment_frames: int, max_frames: int, pushes: list[bool]
) -> None:
    playout = playout_of(segment_frames, 30, 5, queue=QueueConfig(max_frames=max_frames))
    coming = sent(5, segment_frames)
    for push in pushes:
        if push and playout.has_room:
            playout.push(next(coming), 0.0)
        elif not push:
            playout.pop_due()
        assert 0 <= playout.frames_waiting <= max_frames
        assert playout.has_room or playout.next_shown_s is not None
    assert playout.totals.most_frames_waiting <= max_frames


def test_a_full_queue_refuses_and_counts_bytes() -> None:
    playout = playout_of(1, 30, queue=QueueConfig(max_bytes=200))
    playout.push(keyframes(0), 0.0)
    playout.push(packets(1), 0.0)
    assert playout.totals.most_bytes_waiting == 200
    assert not playout.has_room
    with pytest.raises(InvalidError, match="full"):
        playout.push(packets(2), 0.0)
    assert playout.pop_due() is not None
    assert playout.has_room


def test_what_the_next_frame_needs_fits_whatever_the_bounds() -> None:
    playout = playout_of(10, 30, 5, queue=QueueConfig(max_frames=1, max_bytes=1))
    needed = [*itertools.islice(sent(5, 10), 6)]
    for one in needed:
        assert playout.pop_due() is None
        playout.push(one, 1.0)
    due = playout.pop_due()
    assert due is not None
    assert [*due.packets] == needed


def test_frames_come_only_when_they_are_due() -> None:
    playout = playout_of(2, 10, 1)
    playout.push(keyframes(0, 0, 3), 1.0)
    assert playout.next_shown_s is None
    playout.push(packets(1, 0, 3), 2.0)
    playout.push(packets(2), 2.0)
    assert playout.pop_due(1.9) is None
    first = playout.pop_due(2.0)
    assert first is not None
    assert first.record == FrameRecord(1, 3, 198, 2.0, 2.0)
    assert playout.next_shown_s == pytest.approx(2.1)
    assert playout.pop_due(2.05) is None
    second = playout.pop_due(2.1 + EPSILON_S)
    assert second is not None
    assert second.packets == (packets(2),)
    playout.push(packets(3), 3.0)  # due at 2.2
    assert playout.next_shown_s == 3.0
    late = playout.pop_due(math.inf)
    assert late is not None
    assert (late.record.late, playout.totals.stalls, playout.totals.fewest_layers) == (True, 1, 1)
    assert playout.totals.stalled_s == pytest.approx(0.8)
    assert playout.totals.mean_layers == pytest.approx((3 + 1 + 1) / 3)


def test_a_play_waits_for_the_layers_that_it_needs_and_for_more_while_more_comes() -> None:
    playout = playout_of(1, 10, needed=2)
    playout.push(keyframes(0), 1.0)
    assert playout.next_shown_s is None
    playout.push(keyframes(0, 1, 2), 1.5)
    assert playout.next_shown_s == 1.5
    config = PlayoutConfig(start_lead_s=0.3)
    short = playout_of(1, 10, config=config)
    short.push(keyframes(0), 1.0)
    assert short.next_shown_s is None
    short.finish(1.4)
    assert short.next_shown_s == 1.4
    known = playout_of(1, 10, until_frame=1, config=config)
    known.push(keyframes(0), 1.0)
    assert known.next_shown_s == 1.0


def test_what_comes_soon_after_it_was_due_puts_nothing_off() -> None:
    config = PlayoutConfig(start_lead_s=0, resume_lead_s=0, conceal_s=0.25)
    playout = playout_of(1, 10, config=config)
    for one in itertools.islice(sent(0, 1), 3):
        playout.push(one, 1.0)
        assert playout.pop_due() is not None
    assert playout.next_shown_s is None
    playout.push(packets(3), 1.45)  # due at 1.3
    playout.push(packets(4), 1.45)  # due at 1.4
    playout.push(packets(5), 1.45)
    taken = [playout.pop_due() for _ in range(3)]
    records = [one.record for one in taken if one is not None]
    assert [one.concealed for one in records] == [True, True, False]
    assert [one.shown_s for one in records] == pytest.approx([1.3, 1.4, 1.5])
    assert [one.packets for one in taken if one is not None] == [(packets(n),) for n in (3, 4, 5)]
    totals = playout.totals
    assert (totals.stalls, totals.stalled_s, totals.concealed, totals.late_packets) == (0, 0, 2, 0)


@given(gaps_s, lengths, rates, st.floats(0, 1))
def test_concealed_or_not_every_frame_comes_once_and_its_slices_with_it(
    gaps_s: list[float], segment_frames: int, fps: float, conceal_s: float
) -> None:
    config = PlayoutConfig(start_lead_s=0, resume_lead_s=0, conceal_s=conceal_s)
    playout = playout_of(segment_frames, fps, config=config)
    births, records = [], []
    coming = zip(itertools.accumulate(gaps_s), sent(0, segment_frames), strict=False)
    for arrival_s, one in coming:
        playout.push(one, arrival_s)
        while due := playout.pop_due():
            records.append(due.record)
            births += [one.birth for one in due.packets if isinstance(one, SlicePackets)]
            held_s = arrival_s - due.record.due_s
            assert due.record.concealed <= (0 < held_s <= conceal_s + EPSILON_S)
    assert births == list(range(1, len(records)))
    assert [record.frame for record in records] == list(range(len(records)))
    assert playout.totals.concealed == sum(record.concealed for record in records)
    assert not any(record.concealed and record.late for record in records)


def test_a_layer_shows_while_its_chain_is_whole_and_again_once_it_is_mended() -> None:
    playout = playout_of(5, 10, 5)
    playout.push(keyframes(5, 0, 2), 0.0)
    for birth in range(6, 13):
        playout.push(packets(birth, 0, 1 if birth in (8, 9) else 2), 0.0)
    playout.push(packets(8, 1, 2), 0.45)  # frame 10 is due at 0.5
    playout.push(keyframes(10, 1, 2), 0.55)  # frame 11 is due at 0.6
    layers, late = [], []
    while due := playout.pop_due():
        layers.append(due.record.layers)
        late.append(playout.totals.late_packets)
    assert layers == [2, 2, 2, 1, 1, 1, 2, 2]
    assert late == [0, 0, 0, 0, 0, 1, 2, 2]
