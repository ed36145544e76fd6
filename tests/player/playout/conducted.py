"""A stream under a conductor, in a time that stands until the test lets it pass."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

from codec.errors import SwingsError
from codec.framerange import FrameRange
from player.playout.clock import Clock, Smoothing
from player.playout.conductor import Conductor
from player.playout.queues import Events
from player.playout.timeline import FrameRecord, Playout
from player.render.cpu import CpuRenderer
from player.source.directory import DirectorySource
from player.source.source import Source
from server.abr.playout import PlayoutConfig
from tests.support.waiting import BOUND_S, wait_until

AT_ONCE = PlayoutConfig(start_lead_s=0, resume_lead_s=0)
FOLLOWED = ("conduct", "receive", "status", "update")


class World:
    """A time that stands still until it is set."""

    now_s = 100.0

    def __call__(self) -> float:
        return self.now_s


class Played:
    """A stream, its conductor, and the records polled so far."""

    def __init__(self, path: Path, clock: Clock, world: World) -> None:
        self.path, self.clock, self.world = path, clock, world
        self.conductor: Conductor
        self.opened: list[int] = []
        self.records: list[FrameRecord] = []
        self.fails: SwingsError | None = None
        self.may_open = threading.Event()
        self.may_open.set()
        self.smoothing = Smoothing()
        self.events: list[Events] = []

    def open_at(self, frame: int) -> Source:
        if self.fails is not None:
            raise self.fails
        self.opened.append(frame)
        assert self.may_open.wait(BOUND_S)
        return DirectorySource(self.path, FrameRange(frame), None)

    def make_events(self, source: Source, play: int, not_before_s: float) -> Events:
        first, end = source.frames.first, source.frames.end
        playout = Playout(
            source.manifest, first, end, None, AT_ONCE, not_before_s=not_before_s, play=play
        )
        self.events.append(Events(playout, self.clock, smoothing=self.smoothing))
        return self.events[-1]

    def pass_s(self, seconds: float) -> None:
        """Lets time pass, for the conductor, the current play and the next one of a loop."""
        self.world.now_s += seconds
        for events in self.events[-2:]:
            events.time_changed()
        self.conductor._notify()

    def poll_until(self, is_enough: Callable[[], object], step_s: float = 0.0) -> None:
        """step_s: time that passes from one look to the next."""

        def look() -> bool:
            while found := self.conductor.poll():
                self.records += found
            if is_enough():
                return True
            self.pass_s(step_s)
            return False

        wait_until(look)

    def shows(self, frame: int) -> None:
        """Waits until `frame` shows, and no seek is on its way."""
        self.poll_until(
            lambda: (
                bool(self.records)
                and self.records[-1].frame == frame
                and not self.conductor.state().seeking
            )
        )

    def shows_next(self, share: float = 0.0) -> FrameRecord:
        """The next frame, at `share` of the way from its time to that of the one after it."""
        fps, count = self.conductor.transport.fps, len(self.records) + 1
        until_s = self.records[-1].shown_s + (1 + share) / fps + 1e-6
        self.pass_s((until_s - self.clock.now_s()) / self.clock.rate)
        self.poll_until(lambda: len(self.records) >= count)
        assert len(self.records) == count
        return self.records[-1]

    def stands(self) -> None:
        """Nothing more shows, however much time passes."""
        shown, looks = len(self.records), iter(range(5))
        self.poll_until(lambda: next(looks, None) is None, step_s=0.1)
        assert len(self.records) == shown


@contextmanager
def conducted(
    path: Path, *, real: bool = True, plays: float = 1, first: int = 0, paused: bool = False
) -> Iterator[tuple[Played, CpuRenderer]]:
    world = World()
    clock = Clock(real, world)
    if paused:
        clock.stop()
    played = Played(path, clock, world)
    played.conductor = Conductor(
        played.open_at, played.make_events, clock, first, plays, smoothing=played.smoothing
    )
    with playing(played) as renderer:
        yield played, renderer


@contextmanager
def playing(played: Played) -> Iterator[CpuRenderer]:
    """Runs the conductor; no thread of it is left at the end."""
    with played.conductor as conductor:
        renderer = CpuRenderer(conductor.source.manifest)
        conductor.attach(renderer)
        yield renderer
    assert not {*FOLLOWED} & {thread.name for thread in threading.enumerate()}
