"""Seeking, stepping, looping: plays of a real folder, one after another, into a renderer."""

from __future__ import annotations

import gc
import itertools
import math
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest

from codec.errors import SwingsError
from codec.framerange import FrameRange
from codec.stream import StreamWriter
from player.playout.clock import Clock
from player.playout.conductor import Conductor
from player.playout.queues import Events
from player.playout.smoothing import Smoothing
from player.playout.timeline import FrameRecord, Playout
from player.render.cpu import CpuRenderer
from player.source.directory import DirectorySource
from player.source.source import Source
from server.abr.playout import PlayoutConfig
from tests.support.hosted_streams import SWIN_SIZE, random_slice, small_manifest, write_stream
from tests.support.slots.slot_streams import write_busy_stream
from tests.support.slots.updates import small_layout

FPS = 30.0
PATIENCE_S = 20.0
AT_ONCE = PlayoutConfig(start_lead_s=0, resume_lead_s=0)


class Played:
    """A stream under a conductor, and the records polled so far."""

    def __init__(self, path: Path, clock: Clock, plays: float, first: int = 0) -> None:
        self.path = path
        self.opened: list[int] = []
        self.records: list[FrameRecord] = []
        self.fails: SwingsError | None = None
        self.open_s = 0.0  # time that opening takes
        self.smoothing = Smoothing()
        self.conductor = Conductor(
            self.open_at, self.make_events, clock, first, plays, smoothing=self.smoothing
        )
        self.clock = clock

    def open_at(self, frame: int) -> Source:
        if self.fails is not None:
            raise self.fails
        self.opened.append(frame)
        time.sleep(self.open_s)
        return DirectorySource(self.path, FrameRange(frame), None)

    def make_events(self, source: Source, play: int, not_before_s: float) -> Events:
        frames = source.frames
        playout = Playout(
            source.manifest,
            frames.first,
            frames.end,
            None,
            AT_ONCE,
            not_before_s=not_before_s,
            play=play,
        )
        return Events(playout, self.clock, smoothing=self.smoothing)

    def poll_until(self, is_enough: Callable[[], bool]) -> None:
        began_s = time.monotonic()
        while not is_enough():
            assert time.monotonic() < began_s + PATIENCE_S, self.records[-3:]
            records = self.conductor.poll()
            self.records += records
            if not records:
                time.sleep(0.001)

    def shows_anything(self) -> None:
        """Waits until a frame shows: of a play that goes on, one poll may give several."""
        self.poll_until(lambda: bool(self.records))

    def shows(self, frame: int) -> None:
        """Waits until `frame` shows, where the play then stands."""
        self.poll_until(
            lambda: (
                bool(self.records)
                and self.records[-1].frame == frame
                and not self.conductor.state().seeking
            )
        )


@contextmanager
def conducted(
    path: Path, *, real: bool = False, plays: float = 1, first: int = 0, paused: bool = False
) -> Iterator[tuple[Played, CpuRenderer]]:
    clock = Clock(real)
    if paused:
        clock.stop()
    played = Played(path, clock, plays, first)
    with played.conductor as conductor:
        renderer = CpuRenderer(conductor.source.manifest)
        conductor.attach(renderer)
        yield played, renderer
    assert not {"conduct", "receive", "status", "update"} & {
        thread.name for thread in threading.enumerate()
    }


@pytest.fixture(scope="module", params=[1, 2])
def stream(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A stream of 40 frames, of either kind."""
    path = tmp_path_factory.mktemp("conducted") / "s"
    if request.param == 1:
        return write_stream(path, 40)
    write_busy_stream(path, 40, small_layout(3, (4, 3), 0, 5), fps=FPS)
    return path


def picture(path: Path, frame: int) -> np.ndarray[tuple[int, ...], np.dtype[np.float32]]:
    """The picture of a frame in a play that begins with it."""
    with conducted(path, first=frame, real=True, paused=True) as (played, renderer):
        played.shows(frame)
        manifest = played.conductor.source.manifest
        return renderer.render_again(frame, manifest.camera())


def test_it_plays_to_the_end_and_stands_there(stream: Path) -> None:
    with conducted(stream) as (played, _):
        played.shows(39)
        assert [record.frame for record in played.records] == list(range(40))
        assert played.conductor.transport.at_end
        assert played.opened == [0]


def test_a_seek_shows_the_exact_frame_whatever_showed_before(stream: Path) -> None:
    frames = [33, 7, 8, 0, 39, 21]
    expected = {frame: picture(stream, frame) for frame in frames}
    with conducted(stream, real=True, paused=True) as (played, renderer):
        conductor = played.conductor
        camera = conductor.source.manifest.camera()
        for frame in frames:
            conductor.seek(frame)
            played.shows(frame)
            seen = renderer.render_again(frame, camera)
            np.testing.assert_array_equal(seen, expected[frame])
        assert conductor.state().frame == 21
        assert played.opened == [0, *frames]


def test_steps_show_each_frame_once_both_ways_and_time_stands(stream: Path) -> None:
    with conducted(stream, real=True, paused=True, first=10) as (played, _):
        conductor = played.conductor
        played.shows(10)
        for frame in (11, 12, 13):
            conductor.step(1)
            played.shows(frame)
        assert played.opened == [10]  # received data is not requested again
        for frame in (12, 11, 10):
            conductor.step(-1)
            played.shows(frame)
        assert played.opened == [10, 12, 11, 10]
        time.sleep(3 / FPS)
        assert conductor.poll() == []


def test_seeks_that_follow_fast_end_at_the_last_of_them(stream: Path) -> None:
    with conducted(stream, real=True, paused=True) as (played, _):
        conductor = played.conductor
        for frame in (30, 3, 20, 9, 35):
            conductor.seek(frame)
        assert conductor.state().frame == 35
        played.shows(35)
        time.sleep(3 / FPS)
        assert conductor.poll() == []


def test_skips_add_up_while_the_first_of_them_is_on_its_way(stream: Path) -> None:
    with conducted(stream, real=True, paused=True) as (played, _):
        conductor = played.conductor
        played.shows(0)
        played.open_s = 0.1
        for n in range(1, 4):
            conductor.skip(10 / FPS)
            for _ in range(5):
                time.sleep(0.01)
                assert conductor.state().frame == 10 * n
                assert conductor.state().seeking
                # The shown source can be queried at any moment.
                assert conductor.source.manifest.fps == FPS
        conductor.step(-1)
        played.shows(29)
        assert not conductor.state().seeking


@pytest.mark.realtime
def test_a_rate_of_4_shows_all_frames_in_a_quarter_of_the_time(stream: Path) -> None:
    with conducted(stream, real=True) as (played, _):
        for _ in range(9):
            played.conductor.change_rate(1)
        assert played.conductor.state().rate == 4
        played.shows_anything()
        began_s = time.monotonic()
        played.shows(39)
        took_s = time.monotonic() - began_s
        assert [record.frame for record in played.records] == list(range(40))
        assert took_s > 0.9 * 39 / FPS / 4
        assert took_s < 39 / FPS


def test_space_at_the_end_begins_anew(stream: Path) -> None:
    with conducted(stream, first=30) as (played, _):
        played.shows(39)
        played.conductor.seek(35)
        played.shows(39)
        played.conductor.toggle_pause()
        played.poll_until(lambda: played.records[-1].play == 2)
        assert next(record.frame for record in played.records if record.play == 2) == 30
        assert played.opened == [30, 35, 30]


def test_a_loop_neither_drifts_nor_skips_and_ends_when_told(stream: Path) -> None:
    with conducted(stream, plays=3) as (played, _):
        played.poll_until(lambda: len(played.records) == 120)
        shown = [(record.play, record.frame) for record in played.records]
        assert shown == [divmod(n, 40) for n in range(120)]
        first_s = played.records[0].shown_s
        for n, record in enumerate(played.records):
            assert record.shown_s == pytest.approx(first_s + n / FPS, abs=1e-6)
        time.sleep(0.2)
        assert played.conductor.poll() == []
        assert played.opened == [0, 0, 0]


def test_a_loop_that_is_left_ends_at_the_end(stream: Path) -> None:
    with conducted(stream, real=True, plays=math.inf, first=20) as (played, _):
        played.shows_anything()
        # The whole stream has arrived, so the next play is requested.
        played.poll_until(lambda: played.opened == [20, 20])
        played.conductor.toggle_loop()
        played.shows(39)
        time.sleep(0.2)
        assert played.conductor.poll() == []
        assert played.conductor.transport.at_end


def test_a_live_stream_is_followed_from_its_newest_frames(tmp_path: Path) -> None:
    path = tmp_path / "live"
    with StreamWriter.create(path, small_manifest(live=True)) as writer:
        births = iter(range(1 - SWIN_SIZE, 200))
        for birth in births:
            writer.append(random_slice(birth))
            if birth == 99:
                break
        with conducted(path, real=True) as (played, _):
            conductor = played.conductor
            played.shows_anything()
            conductor.seek_newest()
            played.poll_until(lambda: played.records[-1].frame >= 70)
            assert 90 <= conductor.state().end_frame <= 100
            assert not conductor.transport.at_end
            for birth in births:
                writer.append(random_slice(birth))
            played.poll_until(lambda: played.records[-1].frame >= 110)
            played.poll_until(lambda: conductor.state().end_frame > 190)
            conductor.seek(180)
            played.poll_until(lambda: played.records[-1].frame >= 180)


def test_what_fails_on_a_seek_is_raised_by_the_next_look(stream: Path) -> None:
    with conducted(stream) as (played, _):
        played.shows(39)
        played.fails = SwingsError("gone")
        played.conductor.seek(3)
        with pytest.raises(SwingsError, match="gone"):
            played.poll_until(lambda: False)


def test_it_can_be_closed_before_anything_shows(stream: Path) -> None:
    with conducted(stream) as (played, _):
        played.conductor.seek(30)


def blocks_with_full_queues() -> int:
    """Memory blocks of the interpreter after a while without polling."""
    before = 0
    while True:
        gc.collect()
        blocks = sys.getallocatedblocks()
        if abs(blocks - before) < 100:
            return blocks
        before = blocks
        time.sleep(0.5)


def test_an_endless_loop_takes_no_more_with_time(tmp_path: Path) -> None:
    """The loop runs at the speed of the machine: no frame waits until it is due."""
    num_frames, marks = 500, (2_000, 12_000)
    path = write_stream(tmp_path / "s", num_frames)
    expected = itertools.cycle(range(num_frames))
    blocks, shown, first_s = list[int](), 0, 0.0
    with conducted(path, plays=math.inf) as (played, _):
        while shown < marks[-1]:
            records = played.conductor.poll()
            if not records:
                time.sleep(0.0005)
            for record in records:
                first_s = first_s or record.shown_s
                assert record.frame == next(expected)
                assert record.shown_s == pytest.approx(first_s + shown / FPS, abs=1e-3)
                shown += 1
                if shown in marks:
                    # Not the memory of the process, which earlier tests have enlarged.
                    blocks.append(blocks_with_full_queues())
    grown = blocks[1] - blocks[0]
    assert grown < (marks[1] - marks[0]) // 20, f"{grown} objects more: {blocks}"


def test_it_says_how_far_the_way_from_frame_to_frame_is_over(tmp_path: Path) -> None:
    path = write_busy_stream(tmp_path / "s", 40, small_layout(3, (4, 3), 0, 5), fps=FPS)
    with conducted(path, real=True) as (played, renderer):
        conductor, clock = played.conductor, played.clock
        played.poll_until(lambda: bool(played.records) and played.records[-1].frame >= 2)
        assert conductor.share == 1.0
        clock.set_rate(0.25)
        assert conductor.share == 1.0  # the switch is off
        played.smoothing.on = True
        shares: dict[int, list[float]] = {}
        moved = 0

        def look() -> bool:
            nonlocal moved
            frame = played.records[-1].frame
            shares.setdefault(frame, []).append(conductor.share)
            moved += renderer.glide(shares[frame][-1])
            return frame >= 8

        played.poll_until(look)
        whole = [shares[frame] for frame in range(4, 8)]
        assert all(rising == sorted(rising) for rising in whole)
        assert all(rising[0] < 0.5 < rising[-1] for rising in whole)
        assert all(0 <= share <= 1 for rising in whole for share in rising)
        assert moved > 2 * len(whole)
        conductor.toggle_pause()
        assert conductor.share == 1.0
        conductor.poll()
        paused = played.records[-1].frame
        conductor.toggle_pause()
        after: dict[int, list[float]] = {}

        def look_again() -> bool:
            frame = played.records[-1].frame
            after.setdefault(frame, []).append(conductor.share)
            return frame >= paused + 3

        played.poll_until(look_again)
        assert after.pop(paused, [1.0])[-1] == 1.0
        assert all(rising == sorted(rising) for rising in after.values())
        assert min(map(min, after.values())) < 0.5


def test_sound_is_drawn_as_late_as_the_pictures_between_frames(tmp_path: Path) -> None:
    path = write_busy_stream(tmp_path / "s", 40, small_layout(3, (4, 3), 0, 5), fps=10.0)
    with conducted(path, real=True, plays=math.inf, first=30) as (played, _):
        conductor = played.conductor
        played.smoothing.on = True
        compared: dict[int, set[int]] = {}  # the frames of each play
        stood, sought = set[int](), False

        def look() -> bool:
            nonlocal sought
            if not played.records:
                return False
            before = conductor.media_at(time.monotonic())
            share, newest = conductor.share, played.records[-1]
            after = conductor.media_at(time.monotonic())
            if newest.play == 3 and newest.frame == 34 and not sought:
                sought = True
                conductor.seek(32)
            elif before is None and after is None and newest.frame in (30, 32) and share < 1:
                stood.add(newest.frame)
            elif before is not None and after is not None and after < before:
                pass  # a play of the loop has ended in between
            elif before is not None and after is not None and 0 < share < 1:
                behind = 40 if newest.frame == 30 else newest.frame
                assert before[0] - 1e-3 <= behind - 1 + share <= after[0] + 1e-3
                assert before[1] == 1.0
                play = -1 if sought and newest.play > 3 else newest.play
                compared.setdefault(play, set()).add(newest.frame)
            return sought and newest.play > 3 and newest.frame >= 36

        played.poll_until(look)
    # A picture stands until motion follows; in a loop the end is reported meanwhile.
    assert stood == {30, 32}
    assert 30 not in compared.get(0, ())
    assert 32 not in compared.get(-1, ())
    assert any(30 in compared.get(play, ()) for play in (1, 2, 3))
    assert sum(map(len, compared.values())) > 15
