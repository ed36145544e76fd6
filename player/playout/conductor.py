"""Plays a stream from any frame on, one play after another, on one clock.

A play is a request for the stream from a frame on, and the threads that carry it. A seek ends the
one that runs and begins another; at the end of a loop the next one is asked for as soon as all of
the one before has come, so that its first frame shows a frame time after the last one.

conduct_thread begins and ends plays; the renderer polls; commands may come from any thread.
"""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass

from codec.errors import SwingsError
from player.network.fetch import StoppedError
from player.render.renderer import Renderer
from player.source.source import Source

from .clock import Clock, Smoothing
from .queues import Events, Handoff
from .threads import Threads
from .timeline import FrameRecord, Transport, live_lead_s, next_rate

log = logging.getLogger(__name__)

SHARPEN_S = 0.3
"""For so long a picture stands before the layers that it lacks are asked for, seconds."""

OpenAt = Callable[[int], Source]
"""Asks for the stream from a frame on. Raises what a source raises."""

MakeEvents = Callable[[Source, int, float], Events]
"""The queue of a play: its source, its number, and when its first frame may show at the soonest."""


@dataclass(frozen=True, slots=True)
class PlayState:
    """How a playback stands, for people."""

    frame: int
    """The one that shows, or that was asked for if it does not show yet."""
    first_frame: int
    end_frame: int
    """Behind the last frame that one can go to."""
    buffered_until: int
    """Frames before this one can show now."""
    running: bool
    seeking: bool
    """Whether the frame was asked for, and does not show yet."""
    rate: float
    loops: bool
    live: bool


class _Play:
    """One play and its threads. Made by any thread; `update` and `close` belong to one."""

    def __init__(
        self, source: Source, events: Events, number: int, changed: Callable[[], None]
    ) -> None:
        self.source, self.events, self.number = source, events, number
        self.whole = False
        """Whether this play fetches all layers, for a still picture."""
        self.follows_end: int | None = None
        """End of the frames before this play, if it continues a loop."""
        self.handoff: Handoff | None = None
        self._threads = Threads(source, events, changed)
        self._threads.__enter__()

    def update(self, renderer: Renderer) -> None:
        self.handoff = self._threads.update(renderer)

    def media_frame(self, now_s: float, late: bool) -> float | None:
        """The frame that is drawn at `now_s` of the clock, see `Events.media_frame`. late: pictures
        are drawn a frame after their time, and the first one stands until then."""
        frame = self.events.media_frame(now_s)
        if frame is None or not late:
            return frame
        first_frame = self.source.frames.first
        if frame >= first_frame + 1:
            return frame - 1
        return None if self.follows_end is None else frame - 1 - first_frame + self.follows_end

    @property
    def drawn(self) -> bool:
        """Whether its last frame was polled."""
        return self.handoff is not None and self.handoff.ended

    def close(self) -> None:
        self._threads.__exit__()
        self.source.close()


class Conductor:
    """The plays of one window. Leaving the `with` block ends whatever runs."""

    def __init__(
        self,
        open_at: OpenAt,
        make_events: MakeEvents,
        clock: Clock,
        first_frame: int = 0,
        plays: float = 1,
        interrupt: Callable[[], None] = lambda: None,
        open_whole: OpenAt | None = None,
        smoothing: Smoothing | None = None,
        time_s: Callable[[], float] = time.monotonic,
    ) -> None:
        """plays: how often the frames are played; math.inf for without end. interrupt: makes an
        `open_at` that waits raise StoppedError. open_whole: as open_at, but with all layers,
        however long they take; None leaves a picture that stands as it is. smoothing: None draws
        nothing between frames. time_s: seconds of the world, from anywhere."""
        self._open_at, self._make_events = open_at, make_events
        self._interrupt, self._open_whole = interrupt, open_whole
        self._clock, self._time_s = clock, time_s
        self.smoothing = smoothing or Smoothing()
        """Whether pictures between frames are drawn; a key of the window switches it."""
        self._first_frame, self._plays = first_frame, plays
        self._changed = threading.Condition()
        self._renderer: Renderer | None = None
        self._current: _Play | None = None
        self._following: _Play | None = None
        self._wanted: int | None = None
        self._target: int | None = None  # what was sought and does not show yet
        self._source: Source | None = None  # of the play that was begun last
        self._newest: FrameRecord | None = None  # that was polled
        self._shared: FrameRecord | None = None  # of which `_share` was given
        self._share = 1.0
        self._changed_s = 0.0  # when it was, or somebody touched the clock
        self._number = 0
        self._stopped = False
        self._failure: BaseException | None = None
        self.received_bytes = 0
        """Bytes received by the plays that have ended."""
        self._thread = threading.Thread(target=self._conduct, name="conduct")

    def __enter__(self) -> Conductor:
        """Asks for the stream."""
        play = self._start_play(self._first_frame, 0.0)
        frames = play.source.frames
        manifest = play.source.manifest
        lead_s = live_lead_s(manifest.segment_frames / manifest.fps)
        self.transport = Transport(
            frames.first, frames.end, manifest.fps, self._plays, lead_s=lead_s
        )
        self._current, self._target = play, frames.first
        return self

    @property
    def source(self) -> Source:
        """Source of the newest play, for its manifest and known frames; during a seek that of the
        play before."""
        assert self._source is not None
        return self._source

    def attach(self, renderer: Renderer) -> None:
        """Begins to fill `renderer`. Call it once."""
        assert self._current is not None
        self._renderer = renderer
        self._current.update(renderer)
        self._thread.start()

    def __exit__(self, *error: object) -> None:
        with self._changed:
            self._stopped = True
            self._changed.notify_all()
            plays = [play for play in (self._current, self._following) if play is not None]
        for play in plays:
            play.source.interrupt()
        self._interrupt()
        if self._thread.ident is not None:
            self._thread.join()
        for ended in (self._current, self._following):
            if ended is not None:
                self._end_play(ended)

    # What a person wants.

    def seek(self, frame: int) -> None:
        """Goes on from `frame`, or from the nearest one that there is."""
        with self._changed:
            self._look_at_the_end()
            self._seek(self.transport.seek(frame))

    def seek_newest(self) -> None:
        """Goes to the last frame; where more of them come, to where they can be followed from."""
        with self._changed:
            self._look_at_the_end()
            self._seek(self.transport.newest)

    def skip(self, seconds: float) -> None:
        """Goes on from so many seconds of media later, or earlier."""
        with self._changed:
            self._look_at_the_end()
            self._seek(self.transport.skip(seconds, self._target))

    def step(self, frames: int) -> None:
        """Stops, and shows the frame before or behind."""
        with self._changed:
            self._clock.stop()
            if frames > 0 and self.transport.at_end and self._target is None:
                return
            current = self._current
            goes_on = frames == 1 and self._target is None
            if not (goes_on and current is not None and current.events.step()):
                self._seek(self.transport.skip(frames / self.transport.fps, self._target))
            self._time_changed()

    def toggle_pause(self) -> None:
        """Stops, or goes on; at the end, begins anew."""
        with self._changed:
            if self._clock.running and not self.transport.at_end:
                self._clock.stop()
            else:
                self._clock.start()
                if self._current is not None and self._current.whole and self._target is None:
                    self._seek(self.transport.shown or self.transport.first_frame)
                if self.transport.at_end and self._target is None:
                    self._seek(self.transport.first_frame)
            self._time_changed()

    def change_rate(self, steps: int) -> None:
        """Plays faster or slower, by so many of the rates that there are; 0 for as filmed."""
        with self._changed:
            self._clock.set_rate(next_rate(self._clock.rate, steps) if steps else 1.0)
            self._time_changed()

    def toggle_loop(self) -> None:
        with self._changed:
            self.transport.toggle_loop()
            self._changed.notify_all()

    def _seek(self, frame: int) -> None:
        self._wanted = self._target = frame
        self._changed.notify_all()

    def _time_changed(self) -> None:
        self._changed_s = self._time_s()
        self._changed.notify_all()
        for play in (self._current, self._following):
            if play is not None:
                play.events.time_changed()

    # What a window wants.

    def poll(self) -> list[FrameRecord]:
        """The frames that came to be shown, in order; what they need is in the renderer. Raises
        what ended the playback."""
        with self._changed:
            if self._failure is not None:
                raise self._failure
            play = self._current
            if play is None or play.handoff is None or self._wanted is not None:
                return []
            records = play.handoff.poll()
            if records:
                assert self._renderer is not None
                self._newest, self._changed_s = records[-1], self._time_s()
                self._renderer.upload(records[-1].frame)
                self.transport.shown = records[-1].frame
                self._target = None
                if self._lacks_layers():
                    self._changed.notify_all()
            if play.handoff.ended:
                self._changed.notify_all()
            return records

    @property
    def share(self) -> float:
        """How much of the way from the frame before to the one that shows is over, for a Renderer's
        `glide`: less than 1 only where pictures between frames are drawn, and then up to a frame
        later than the frame itself is due. A paused playback shows an exact frame, and goes on from
        there: within a frame the share never falls."""
        with self._changed:
            least = self._share if self._newest is self._shared else 0.0
            self._shared, self._share = self._newest, max(least, self._share_now())
            return self._share

    def _share_now(self) -> float:
        if self._newest is None or not self._clock.running:
            return 1.0
        if not self.smoothing.shows_between(self._clock.rate * self.transport.fps):
            return 1.0
        passed_s = self._clock.now_s() - self._newest.shown_s
        return min(max(passed_s * self.transport.fps, 0.0), 1.0)

    def media_at(self, world_s: float) -> tuple[float, float] | None:
        """The frame, with its fraction, that is to be drawn at `world_s` of the clock's `time_s`,
        and the rate of the playback; None while the picture stands. Like `share`, a frame late
        where pictures between frames are drawn. Never waits for a renderer."""
        shown = self._clock.at(world_s)
        if shown is None or self._wanted is not None:
            return None
        now_s, rate = shown
        late = self.smoothing.shows_between(rate * self.transport.fps)
        for play in (self._current, self._following):
            frame = play.media_frame(now_s, late) if play is not None else None
            if frame is not None:
                return frame, rate
        return None

    def state(self) -> PlayState:
        with self._changed:
            transport, play = self.transport, self._current
            frame = transport.shown if self._target is None else self._target
            frame = transport.first_frame if frame is None else frame
            buffered = play.events.end_frame if play is not None else frame
            self._look_at_the_end()
            return PlayState(
                frame,
                transport.first_frame,
                transport.last_frame + 1,
                buffered,
                self._clock.running,
                self._target is not None,
                self._clock.rate,
                transport.loops,
                play is not None and play.source.manifest.live,
            )

    def _look_at_the_end(self) -> None:
        """A live stream has grown."""
        if self._current is not None:
            num_frames = self._current.source.num_frames
            self.transport.known_end = max(self.transport.known_end, num_frames)

    # conduct_thread

    def _conduct(self) -> None:
        try:
            while True:
                with self._changed:
                    while not self._has_work():
                        self._changed.wait(SHARPEN_S if self._lacks_layers() else None)
                    if self._stopped:
                        return
                    frame, current, following = self._wanted, self._current, self._following
                    blurred = self._newest if self._is_to_sharpen() else None
                if frame is not None:
                    self._go_to(frame)
                elif blurred is not None:
                    self._sharpen(blurred.frame)
                elif following is not None and not self.transport.loops:
                    self._forget_following(following)
                elif current is not None and following is not None:
                    self._go_on(current, following)
                elif current is not None:
                    self._follow(current)
        except StoppedError:
            pass
        except BaseException as error:
            with self._changed:
                self._failure = error

    def _has_work(self) -> bool:
        if self._stopped or self._wanted is not None or self._is_to_sharpen():
            return True
        current, loops = self._current, self.transport.loops
        if current is None:
            return False
        if self._following is not None:
            return current.drawn or not loops
        return loops and current.events.finished

    def _lacks_layers(self) -> bool:
        """Whether a picture stands that lacks layers, and the rest of it may be asked for."""
        current, newest = self._current, self._newest
        return (
            self._open_whole is not None
            and not self._clock.running
            and self._target is None
            and newest is not None
            and current is not None
            and newest.play == current.number
            and current.source.adaptive
            and newest.layers < current.source.num_layers
        )

    def _is_to_sharpen(self) -> bool:
        return self._lacks_layers() and self._time_s() >= self._changed_s + SHARPEN_S

    def _sharpen(self, frame: int) -> None:
        """Shows `frame`, which stands, with all layers."""
        try:
            self._go_to(frame, whole=True)
        except StoppedError:
            raise
        except SwingsError as error:  # such as a server that has no time for all layers
            log.info("the picture stays unchanged: %s", error)
            self._open_whole = None
            self._go_to(frame)

    def _start_play(self, frame: int, not_before_s: float, whole: bool = False) -> _Play:
        open_at = self._open_whole if whole else None
        source = (open_at or self._open_at)(frame)
        try:
            events = self._make_events(source, self._number, not_before_s)
            play = _Play(source, events, self._number, self._notify)
        except BaseException:
            source.close()
            raise
        play.whole = whole
        self._number += 1
        self._source = source
        return play

    def _end_play(self, play: _Play) -> None:
        play.close()
        self.received_bytes += play.source.received_bytes

    def _notify(self) -> None:
        with self._changed:
            self._changed.notify_all()

    def _go_to(self, frame: int, whole: bool = False) -> None:
        """Ends what plays, and plays from `frame` on; whole: with all layers."""
        with self._changed:
            ended = [play for play in (self._current, self._following) if play is not None]
            self._current = self._following = None
        for play in ended:
            self._end_play(play)
        assert self._renderer is not None
        self._renderer.forget_waiting()
        play = self._start_play(frame, 0.0, whole)
        play.update(self._renderer)
        with self._changed:
            self._current = play
            if self._wanted == frame:
                self._wanted = None

    def _follow(self, current: _Play) -> None:
        """Asks for the next play of a loop, whose frames show behind those of `current`."""
        following = self._start_play(self.transport.first_frame, current.events.end_s or 0.0)
        following.follows_end = current.events.end_frame
        with self._changed:
            self._following = following

    def _forget_following(self, following: _Play) -> None:
        """It does not begin anew after all."""
        with self._changed:
            self._following = None
        self._end_play(following)

    def _go_on(self, current: _Play, following: _Play) -> None:
        """The next play of a loop takes its turn."""
        self._end_play(current)
        assert self._renderer is not None
        following.update(self._renderer)
        with self._changed:
            self.transport.plays_left -= 1
            self._current, self._following = following, None
