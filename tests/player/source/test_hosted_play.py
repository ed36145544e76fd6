"""Requests for a stream of files, and their results, without sockets or clocks."""

from __future__ import annotations

import itertools
import json
import re
from collections import Counter
from dataclasses import replace
from pathlib import Path
from statistics import fmean
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from codec.errors import CorruptError
from codec.framerange import FrameRange
from codec.splats import Splats
from codec.stream import StreamReader
from codec.stream.manifest import SKIP_MAPS, Part, keyframe_part, layer_of
from player.playout.assembler import Assembler
from player.playout.timeline import FrameRecord, Playout
from player.run.playback import WINDOW_PLAYOUT
from player.source.hostedplay import Ask, HostedPlay, PartialObject
from player.source.opener import opened
from player.source.source import Packets, SlicePackets
from server.abr.clientstatus import ClientStatus
from server.abr.holding import Holding
from server.abr.session import Finished
from tests.support.commands import ROOT
from tests.support.delivery.assembled import check_packets
from tests.support.drawn import same_splats
from tests.support.slots.slot_streams import Shown, write_busy_stream
from tests.support.slots.updates import small_layout

NUM_FRAMES, FPS, STEP_S = 120, 30.0, 0.005


@pytest.fixture(scope="module")
def reader(tmp_path_factory: pytest.TempPathFactory) -> StreamReader:
    path = tmp_path_factory.mktemp("root") / "s"
    write_busy_stream(path, NUM_FRAMES, small_layout(4, (60, 60, 60), 0, 20), fps=FPS)
    return StreamReader(path)


class MadeLink:
    """The host of a stream behind a link, one request after another."""

    def __init__(
        self,
        reader: StreamReader,
        play: HostedPlay,
        knows_ranges: bool = True,
        hole: tuple[str, str] = ("", ""),
        round_trip_s: float = 0.0,
    ) -> None:
        """hole: an object that the host lacks or has damaged, and how."""
        self._round_trip_s = round_trip_s
        self._reader, self._play = reader, play
        self._knows_ranges, self._hole = knows_ranges, hole
        self._open: list[tuple[Ask, int]] = []
        self._begins_s: dict[Ask, float] = {}
        self.asked: list[Ask] = []
        self.now_s = 0.0

    def packets(self, rate_bps: float) -> list[Packets]:
        """The packets of one step of time; nothing is left after it."""
        play, found = self._play, list[Packets]()
        while isinstance(decision := play.next(self.now_s), Ask):
            if not self._knows_ranges:
                play.comes_whole(decision, self.now_s)
            self.asked.append(decision)
            self._open.append((decision, decision.first_byte))
            self._begins_s[decision] = self.now_s + self._round_trip_s
        self.over = isinstance(decision, Finished) and not self._open
        found += play.packets()
        left = round(rate_bps * STEP_S / 8)
        while self._open and left and self._begins_s[self._open[0][0]] <= self.now_s:
            ask, at = self._open.pop(0)
            data = self._reader.read_object(ask.segment, ask.part).data
            if f"{ask.segment}/{ask.part}" == self._hole[0]:
                try:
                    self._take_damaged(ask, data)
                except CorruptError:
                    if layer_of(ask.part) == 0:
                        raise
                    lost = play.lose(ask.segment, layer_of(ask.part), self.now_s)
                    self._open = [one for one in self._open if one[0] not in lost]
                continue
            end = min(ask.end_byte, at + left)
            play.come(ask, "host", at, data[at:end])
            left -= end - at
            if end == ask.end_byte:
                play.ended(ask)
            else:
                self._open.insert(0, (ask, end))
        self.now_s += STEP_S
        return [*found, *play.packets()]

    def _take_damaged(self, ask: Ask, data: bytes) -> None:
        fault = self._hole[1]
        if fault == "missing":
            raise CorruptError("HTTP 404")
        if fault == "flipped":
            data = data[:-9] + bytes([data[-9] ^ 1]) + data[-8:]
        self._play.come(ask, "host", ask.first_byte, data[ask.first_byte : ask.end_byte])
        if fault == "cut":
            raise CorruptError("the response ended early")
        self._play.ended(ask)


def need_bps(reader: StreamReader, num_frames: int = NUM_FRAMES) -> float:
    return 8 * FPS * sum(record.played_bytes for record in reader.records) / num_frames


@pytest.mark.parametrize("knows_ranges", [True, False])
@pytest.mark.parametrize("first", [0, 33])
def test_on_a_link_that_carries_it_all_comes_once_and_in_time(
    reader: StreamReader, knows_ranges: bool, first: int
) -> None:
    play = HostedPlay(reader.manifest, reader.records, FrameRange(first, NUM_FRAMES), 0.0)
    link = MadeLink(reader, play, knows_ranges)
    counts: Counter[tuple[int, int, bool]] = Counter()
    last = first
    while True:
        for one in link.packets(2 * need_bps(reader)):
            check_packets(reader, one)
            assert len(one.packets) == 1
            birth, is_slice = one.first_frame, isinstance(one, SlicePackets)
            counts[birth, one.first_layer, is_slice] += 1
            if is_slice and one.first_layer == 0 and birth > first:
                assert birth > last
                last = birth
                clock = play.session.clock
                assert clock.started_s is None or link.now_s <= clock.due_s(birth)
        if link.over:
            break
    assert set(counts.values()) == {1}
    late = NUM_FRAMES - 20
    assert all(counts[birth, n, True] for birth in range(late, NUM_FRAMES) for n in range(3))
    assert all(counts[birth, 0, True] for birth in range(first + 1, NUM_FRAMES))
    assert link.now_s <= (NUM_FRAMES - first) / FPS + 0.5


def watched(
    reader: StreamReader,
    steps: list[tuple[float, float]],
    knows_ranges: bool = True,
    round_trip_s: float = 0.0,
    said: list[str] | None = None,
) -> tuple[list[FrameRecord], Playout]:
    """A window's play over a link. steps: seconds, and what it carries as a share of the stream.
    said: gets what the viewer is told."""
    play = HostedPlay(reader.manifest, reader.records, FrameRange(0, NUM_FRAMES), 0.0)
    link = MadeLink(reader, play, knows_ranges, round_trip_s=round_trip_s)
    playout = Playout(reader.manifest, 0, NUM_FRAMES, config=WINDOW_PLAYOUT)
    ends_s, frames = [*itertools.accumulate(seconds for seconds, _ in steps)], list[FrameRecord]()
    while not frames or frames[-1].frame < NUM_FRAMES - 1:
        step = next(n for n, end_s in enumerate(ends_s) if link.now_s < end_s)
        for one in link.packets(steps[step][1] * need_bps(reader)):
            playout.push(one, link.now_s)
        while (due := playout.pop_due(link.now_s)) is not None:
            frames.append(due.record)
        told = play.note_status(link.now_s, ClientStatus(*playout.place(link.now_s)))
        if told and said is not None:
            said.append(told)
    return frames, playout


LAWS: list[tuple[list[tuple[float, float]], list[tuple[float, float, float, float]]]] = [
    # Of what it carries all shows, almost from the start.
    ([(60.0, 1.5)], [(2.0, 9.0, 2.9, 3.0), (0.0, 9.0, 2.4, 3.0)]),
    # A link that falls to half of it goes on with fewer layers.
    ([(1.5, 1.5), (60.0, 0.5)], [(0.8, 1.4, 2.2, 3.0), (2.0, 9.0, 1.0, 2.7)]),
    # One that comes back brings the layers back.
    ([(1.0, 1.5), (1.2, 0.5), (60.0, 2.0)], [(1.6, 2.2, 1.0, 2.7), (3.5, 9.0, 2.7, 3.0)]),
]
"""What a link carries: seconds, and the share of the stream. Mean layers from a to b seconds after
the first picture, at least and at most."""


@pytest.mark.parametrize("knows_ranges", [True, False])
@pytest.mark.parametrize(("steps", "laws"), LAWS)
def test_layers_follow_the_link_without_a_stall(
    reader: StreamReader,
    knows_ranges: bool,
    steps: list[tuple[float, float]],
    laws: list[tuple[float, float, float, float]],
) -> None:
    frames, playout = watched(reader, steps, knows_ranges)
    assert [one.frame for one in frames] == list(range(NUM_FRAMES))
    assert frames[0].shown_s < 0.5
    # A host without ranges finishes every begun object, even if the link has become slow.
    assert playout.totals.stalled_s <= (0.0 if knows_ranges else 0.4)
    first_s = frames[0].shown_s
    for begin_s, end_s, least, most in laws:
        part = [one.layers for one in frames if begin_s <= one.shown_s - first_s < end_s]
        assert least <= fmean(part) <= most


def test_a_far_host_is_asked_for_more_at_once(reader: StreamReader) -> None:
    # A segment lasts for less than two round trips.
    frames, playout = watched(reader, [(60.0, 3.0)], round_trip_s=0.4)
    assert playout.totals.stalls == 0
    assert fmean(one.layers for one in frames if one.shown_s > 1.5) > 2.5


def test_a_link_that_is_too_slow_plays_in_few_pieces(reader: StreamReader) -> None:
    base_bytes = sum(record.object_bytes[0] + record.side_bytes[0] for record in reader.records)
    share = 0.3 * 8 * FPS * base_bytes / NUM_FRAMES / need_bps(reader)
    said = list[str]()
    frames, playout = watched(reader, [(60.0, share)], said=said)
    assert [one.frame for one in frames] == list(range(NUM_FRAMES))
    assert playout.totals.stalls <= 3
    assert len(said) == 1
    assert re.match(
        r"this connection carries \S+ of the \S+ Mbit/s that this video needs$", said[0]
    )


def test_a_play_with_a_known_rate_asks_for_layer_0_of_its_frame_and_no_more_yet(
    reader: StreamReader,
) -> None:
    play = HostedPlay(reader.manifest, reader.records, FrameRange(75, NUM_FRAMES), 0.0, 1e9)
    asked = []
    while isinstance(decision := play.next(0.0), Ask):
        asked.append(decision)
    # Layer 0 of a segment is two objects; more requests at once would share the link badly.
    assert [(ask.segment, ask.part) for ask in asked] == [(3, "keyframe-0"), (3, SKIP_MAPS), (3, 0)]


HOLES: list[dict[str, Any]] = json.loads(Path(__file__).with_name("holes.json").read_text())
"""What a host lacks or has damaged, and the layers that segments show then; the browser's tests
read it, too."""


@pytest.mark.parametrize("hole", HOLES, ids=lambda hole: f"{hole['part']}-{hole['fault']}")
def test_a_hole_above_layer_0_costs_its_layer_for_its_segment(hole: dict[str, Any]) -> None:
    reader = StreamReader(ROOT / "conformance" / "streams" / "far")
    manifest, last = reader.manifest, reader.records[-1]
    end = last.first_frame + last.num_frames
    play = HostedPlay(manifest, reader.records, FrameRange(0, end), 0.0)
    link = MadeLink(reader, play, hole=(hole["part"], hole["fault"]))
    here = Holding(play.media, 0)

    def watch() -> None:
        link.over = False
        while not link.over:
            for one in link.packets(1e8):
                one.add_to(here)

    if hole["layers"] is None:
        with pytest.raises(CorruptError):
            watch()
        return
    watch()
    ends = [record.first_frame + record.num_frames - 1 for record in reader.records]
    assert [here.whole_layers(frame) for frame in ends] == hole["layers"]


def test_a_damaged_packet_above_layer_0_counts_as_missing_in_an_adaptive_play() -> None:
    path = ROOT / "conformance" / "streams" / "far"
    with opened(str(path)) as source:
        packets = list(source.packets())

    def shown(spoiled: bytes | None, mends: bool) -> list[Splats]:
        assembler, shown = Assembler(source.manifest, 3, 0, mends), Shown(source.manifest)
        found = []
        for frame in range(12):
            used = [one for one in packets if one.first_frame == frame]
            if frame == 6:
                assert isinstance(used[0], SlicePackets)
                kept = used[0].packets if spoiled is None else (used[0].packets[0], spoiled)
                used[0] = replace(used[0], packets=kept[: 1 if spoiled == b"gone" else None])
            found.append(shown.after(assembler.assemble(frame, used), frame))
        return found

    change = next(one for one in packets if one.first_frame == 6).packets[1]
    spoiled = change[:-9] + bytes([change[-9] ^ 1]) + change[-8:]
    without, whole = shown(b"gone", True), shown(None, True)
    assert not same_splats(without[6], whole[6])
    assert all(map(same_splats, shown(spoiled, True), without))
    with pytest.raises(CorruptError):
        shown(spoiled, False)


# --- one object


@st.composite
def hauls(draw: st.DrawFn) -> tuple[int, Part, list[range], int]:
    """An object of a stream, runs of births to request, and bytes that arrive together."""
    parts: list[Part] = [0, 1, 2, SKIP_MAPS, keyframe_part(1)]
    segment, part = draw(st.integers(0, 5)), draw(st.sampled_from(parts))
    first = segment * 20
    end = first + 1 if str(part).startswith("keyframe") else (segment + 1) * 20
    edges = draw(st.lists(st.tuples(st.integers(first, end - 1), st.integers(1, 20)), min_size=1))
    runs = [range(begin, min(end, begin + count)) for begin, count in edges]
    return segment, part, runs, draw(st.integers(1, 5000))


@given(hauls())
@settings(max_examples=25, deadline=None)
def test_whatever_is_asked_for_comes_and_is_what_the_object_holds(
    reader: StreamReader, haul: tuple[int, Part, list[range], int]
) -> None:
    segment, part, runs, piece_bytes = haul
    kept = reader.read_object(segment, part)
    pieces = PartialObject(reader.manifest, reader.records[segment], part)
    for births in runs:
        for _ in range(3):
            if all(pieces.has(birth) for birth in births):
                break
            run = pieces.ask(births)
            assert run is not None
            for at in range(run.start, run.stop, piece_bytes):
                pieces.add(at, kept.data[at : min(at + piece_bytes, run.stop)])
        assert [pieces.packet(birth) for birth in births] == [kept.packet(b) for b in births]
    whole = pieces.ask(pieces.births)
    if whole is not None:
        pieces.add(whole.start, kept.data[whole.start : whole.stop])
    assert pieces.whole() == kept.data

    altered = PartialObject(reader.manifest, reader.records[segment], part)
    altered.name = "there"
    altered.add(0, kept.data[:-1] + bytes([kept.data[-1] ^ 1]))
    with pytest.raises(CorruptError, match=r"^there: .*was altered"):
        altered.whole()
