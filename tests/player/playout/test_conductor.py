"""Seeking, stepping, looping: plays of a real folder, one after another, into a renderer."""

from __future__ import annotations

import gc
import itertools
import math
import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from codec.errors import SwingsError
from codec.framerange import FrameRange
from codec.stream import StreamWriter
from player.playout.clock import Clock
from player.playout.conductor import SHARPEN_S, Conductor
from player.source.directory import DirectorySource
from player.source.source import Packets, Source
from tests.player.playout.conducted import Played, World, conducted, playing
from tests.support.hosted_streams import SWIN_SIZE, random_slice, small_manifest, write_stream
from tests.support.slots.slot_streams import write_busy_stream
from tests.support.slots.updates import small_layout

FPS = 30.0
FRAMES = 40


def write_slots(path: Path, fps: float = FPS) -> Path:
    return write_busy_stream(path, FRAMES, small_layout(3, (4, 3), 0, 5), fps=fps)


@pytest.fixture(scope="module")
def stream(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_slots(tmp_path_factory.mktemp("conducted") / "s")


def picture(path: Path, frame: int) -> np.ndarray[tuple[int, ...], np.dtype[np.float32]]:
    """The picture of a frame in a play that begins with it."""
    with conducted(path, first=frame, paused=True) as (played, renderer):
        played.shows(frame)
        return renderer.render_again(frame, played.conductor.source.manifest.camera())


def test_it_plays_to_the_end_and_stands_there(stream: Path) -> None:
    with conducted(stream, real=False) as (played, _):
        played.shows(39)
        assert [record.frame for record in played.records] == list(range(40))
        assert played.conductor.transport.at_end
        played.stands()
        assert played.opened == [0]


@pytest.mark.parametrize("slots", [False, True])
def test_a_seek_shows_the_exact_frame_whatever_showed_before(tmp_path: Path, slots: bool) -> None:
    path = write_slots(tmp_path / "s") if slots else write_stream(tmp_path / "s", FRAMES)
    frames = [33, 7, 8, 0, 39, 21]
    expected = {frame: picture(path, frame) for frame in frames}
    with conducted(path, paused=True) as (played, renderer):
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
    with conducted(stream, first=10) as (played, _):
        conductor = played.conductor
        played.shows(10)
        for frame in (11, 12, 13):
            conductor.step(1)
            assert not conductor.state().running
            played.shows(frame)
        assert played.opened == [10]  # received data is not requested again
        for frame in (12, 11, 10):
            conductor.step(-1)
            played.shows(frame)
        assert played.opened == [10, 12, 11, 10]
        played.stands()
        conductor.seek(39)
        played.shows(39)
        conductor.step(1)  # behind the end there is nothing
        played.stands()
        assert played.opened[-1] == 39


def test_seeks_that_follow_fast_end_at_the_last_of_them(stream: Path) -> None:
    with conducted(stream, paused=True) as (played, _):
        conductor = played.conductor
        for frame in (30, 3, 20, 9, 35):
            conductor.seek(frame)
        assert conductor.state().frame == 35
        played.shows(35)
        played.stands()


def test_skips_add_up_while_the_first_of_them_is_on_its_way(stream: Path) -> None:
    with conducted(stream, paused=True) as (played, _):
        conductor = played.conductor
        played.shows(0)
        played.may_open.clear()
        for n in range(1, 4):
            conductor.skip(10 / FPS)
            state = conductor.state()
            assert (state.frame, state.seeking) == (10 * n, True)
            # The shown source can be queried at any moment.
            assert conductor.source.manifest.fps == FPS
        conductor.step(-1)
        played.may_open.set()
        played.shows(29)


def test_the_rate_is_that_of_the_frames(stream: Path) -> None:
    with conducted(stream) as (played, _):
        conductor = played.conductor
        played.shows(0)
        played.shows_next()
        for steps, rate in ((9, 4.0), (-9, 0.1), (0, 1.0), (2, 2.0)):
            conductor.change_rate(steps)
            assert conductor.state().rate == rate
            before_s = played.world.now_s
            for _ in range(3):
                played.shows_next()
            assert played.world.now_s - before_s == pytest.approx(3 / FPS / rate, abs=1e-4)
        assert [record.frame for record in played.records] == list(range(14))


def test_space_at_the_end_begins_anew(stream: Path) -> None:
    with conducted(stream, first=30, real=False) as (played, _):
        played.shows(39)
        played.may_open.clear()
        played.conductor.seek(35)
        played.conductor.toggle_pause()
        assert played.conductor.state().frame == 35  # a seek on its way stays
        played.may_open.set()
        played.poll_until(lambda: played.records[-1].play == 1)
        played.shows(39)
        played.conductor.toggle_pause()
        played.poll_until(lambda: played.records[-1].play == 2)
        assert next(record.frame for record in played.records if record.play == 2) == 30
        assert played.opened == [30, 35, 30]


def test_a_loop_neither_drifts_nor_skips_and_ends_when_told(stream: Path) -> None:
    with conducted(stream, plays=3, real=False) as (played, _):
        played.poll_until(lambda: len(played.records) == 120)
        shown = [(record.play, record.frame) for record in played.records]
        assert shown == [divmod(n, 40) for n in range(120)]
        for n, record in enumerate(played.records):
            assert record.shown_s == pytest.approx(n / FPS, abs=1e-6)
        played.stands()
        assert played.opened == [0, 0, 0]


def test_a_loop_that_is_left_ends_at_the_end(stream: Path) -> None:
    with conducted(stream, plays=math.inf, first=20) as (played, _):
        played.shows(20)
        # The whole stream has arrived, so the next play is requested.
        played.poll_until(lambda: played.opened == [20, 20])
        played.conductor.toggle_loop()
        played.poll_until(lambda: played.records[-1].frame == 39, step_s=1 / FPS)
        played.stands()
        assert played.conductor.transport.at_end


def test_a_live_stream_is_followed_from_its_newest_frames(tmp_path: Path) -> None:
    path = tmp_path / "live"
    with StreamWriter.create(path, small_manifest(live=True)) as writer:
        births = iter(range(1 - SWIN_SIZE, 200))
        for birth in itertools.islice(births, 99 + SWIN_SIZE):
            writer.append(random_slice(birth))
        with conducted(path) as (played, _):
            conductor = played.conductor
            played.shows(0)
            assert conductor.state().live
            conductor.seek_newest()
            played.poll_until(lambda: played.records[-1].frame >= 70, step_s=1 / FPS)
            assert 90 <= conductor.state().end_frame <= 100
            assert not conductor.transport.at_end
            for birth in births:
                writer.append(random_slice(birth))
            played.poll_until(lambda: played.records[-1].frame >= 110, step_s=1 / FPS)
            played.poll_until(lambda: conductor.state().end_frame > 190)
            conductor.seek(180)
            played.poll_until(lambda: played.records[-1].frame >= 180)


def test_what_fails_on_a_seek_is_raised_by_the_next_look(stream: Path) -> None:
    with conducted(stream, real=False) as (played, _):
        played.shows(39)
        played.fails = SwingsError("gone")
        played.conductor.seek(3)
        with pytest.raises(SwingsError, match="gone"):
            played.poll_until(lambda: False)


def test_it_can_be_closed_before_anything_shows(stream: Path) -> None:
    with conducted(stream) as (played, _):
        played.conductor.seek(30)


def blocks_after(path: Path, num_frames: int) -> int:
    """Memory blocks of the interpreter once an endless loop has shown so many frames, and all its
    threads have ended."""
    expected = itertools.cycle(range(FRAMES))
    with conducted(path, plays=math.inf, real=False) as (played, _):
        shown = 0
        while shown < num_frames:
            played.poll_until(lambda: played.records)
            for record in played.records:
                assert record.frame == next(expected)
                assert record.shown_s == pytest.approx(shown / FPS, abs=1e-3)
                shown += 1
            played.records.clear()
            del played.opened[:], played.events[:-2]
    conductor = played.conductor
    conductor._current = conductor._following = None  # what waits in their queues is chance
    played.events.clear()
    gc.collect()
    blocks = sys.getallocatedblocks()
    assert conductor.transport.loops  # the conductor is still here
    return blocks


def test_an_endless_loop_takes_no_more_with_time(stream: Path) -> None:
    blocks_after(stream, 100)
    few, many = (blocks_after(stream, count) for count in (200, 1200))
    assert many - few < 500


def test_it_says_how_far_the_way_from_frame_to_frame_is_over(stream: Path) -> None:
    with conducted(stream) as (played, renderer):
        conductor = played.conductor
        played.shows(0)
        assert conductor.share == 1.0
        played.clock.set_rate(0.25)
        played.shows_next(0.5)
        assert conductor.share == 1.0  # the switch is off
        played.smoothing.on = True
        assert conductor.share == 1.0  # within a frame it never falls
        moved = 0
        for _ in range(3):
            for share in (0.25, 0.5, 0.75):
                if share == 0.25:
                    played.shows_next(share)
                else:
                    played.pass_s(0.25 / FPS / 0.25)
                assert conductor.share == pytest.approx(share, abs=1e-3)
                moved += renderer.glide(conductor.share)
        assert moved == 9
        conductor.toggle_pause()
        assert conductor.share == 1.0
        conductor.toggle_pause()
        assert conductor.share == 1.0
        played.shows_next(0.5)
        assert conductor.share == pytest.approx(0.5, abs=1e-3)
        played.clock.set_rate(4.0)  # as fast as the pictures of the screen
        played.shows_next(0.5)
        assert conductor.share == 1.0


def test_sound_is_drawn_as_late_as_the_pictures_between_frames(tmp_path: Path) -> None:
    path = write_slots(tmp_path / "s", fps=10.0)
    with conducted(path, plays=math.inf, first=36) as (played, _):
        conductor = played.conductor
        played.shows(36)

        def heard() -> object:
            return conductor.media_at(played.world())

        def next_follows(plays: int) -> None:
            """Waits until all of the next play has come."""
            played.poll_until(
                lambda: len(played.events) == plays and played.events[-1].end_frame == FRAMES
            )

        next_follows(2)
        assert heard() == pytest.approx((36.0, 1.0))
        played.smoothing.on = True
        assert heard() is None  # a picture stands until motion follows
        played.clock.set_rate(0.5)
        for plays in (3, 4):
            for frame in (37, 38, 39):
                assert played.shows_next(0.25).frame == frame
                assert heard() == pytest.approx((frame - 0.75, 0.5), abs=1e-3)
                assert conductor.share == pytest.approx(0.25, abs=1e-3)
            # In a loop the end is heard before the beginning.
            assert played.shows_next(0.25).frame == 36
            assert heard() == pytest.approx((39.25, 0.5), abs=1e-3)
            next_follows(plays)
        conductor.seek(38)
        assert heard() is None
        played.shows(38)
        assert heard() is None
        played.shows_next(0.25)
        assert heard() == pytest.approx((38.25, 0.5), abs=1e-3)
        played.clock.stop()
        assert heard() is None


@pytest.mark.parametrize("refused", [False, True])
def test_a_picture_that_stands_gets_the_layers_that_it_lacks(stream: Path, refused: bool) -> None:
    whole, expected = list[int](), picture(stream, 17)

    class Thin(DirectorySource):
        """A play that has only the first layer so far."""

        def packets(self) -> Iterator[Packets]:
            return DirectorySource(stream, self.frames, 1).packets()

    def open_thin(frame: int) -> Source:
        source = Thin(stream, FrameRange(frame), None)
        source.adaptive = True
        return source

    def open_whole(frame: int) -> Source:
        whole.append(frame)
        if refused:
            raise SwingsError("there is no time")
        return DirectorySource(stream, FrameRange(frame), None)

    world = World()
    played = Played(stream, Clock(True, world), world)
    conductor = played.conductor = Conductor(
        open_thin, played.make_events, played.clock, 17, open_whole=open_whole, time_s=world
    )
    with playing(played) as renderer:
        camera = conductor.source.manifest.camera()
        played.shows(17)
        conductor.toggle_pause()
        played.pass_s(0.9 * SHARPEN_S)
        assert not whole
        played.pass_s(0.2 * SHARPEN_S)
        played.poll_until(lambda: len(played.records) == 2)
        assert [(one.frame, one.layers) for one in played.records] == [(17, 1), (17, 2 - refused)]
        played.stands()
        assert whole == [17]  # once, whatever the answer
        if refused:
            return
        seen = renderer.render_again(17, camera)
        np.testing.assert_array_equal(seen, expected)
        conductor.toggle_pause()
        played.poll_until(lambda: played.records[-1].frame >= 20, step_s=1 / FPS)
        assert played.records[-1].layers == 1
        assert conductor.source.adaptive
