"""The threads of Algorithm 2: in order, with bounded queues, and ending together."""

from __future__ import annotations

import tempfile
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor, wait
from pathlib import Path

import numpy as np
import pytest

from codec.arrays import Floats
from codec.camera import Camera
from codec.errors import SwingsError
from codec.framerange import FrameRange
from codec.slice import Slice
from codec.stream.manifest import Manifest
from player.network.fetch import StoppedError
from player.playout.clock import Clock, OutputTimes
from player.playout.queues import Events, Handoff
from player.playout.threads import Threads, render_thread
from player.playout.timeline import FrameRecord, Playout, QueueConfig
from player.render.cpu import CpuRenderer
from player.source.directory import DirectorySource
from player.source.source import NO_PLAY, REPORT_S, Packets
from server.abr.clientstatus import ClientStatus
from tests.player.playout.conducted import AT_ONCE, FOLLOWED, World
from tests.support.hosted_streams import SWIN_SIZE, small_manifest, write_stream
from tests.support.waiting import BOUND_S, wait_until

CAMERA = small_manifest().camera()


def packets_of_frames(count: int) -> list[Packets]:
    """Layer 0 of frames 0 to count-1: a keyframe for the first, slices for the others."""
    with tempfile.TemporaryDirectory() as folder:
        path = write_stream(Path(folder) / "s", count, 4, 0)
        return list(DirectorySource(path, FrameRange(), 1).packets())


PACKETS = packets_of_frames(40)


def events_of(fps: float, clock: Clock, queue: QueueConfig | None = None) -> Events:
    return Events(Playout(small_manifest(4, 0, fps), 0, None, queue, AT_ONCE), clock)


class ListSource:
    """Packets from a list, then an error if there is one, else nothing forever where it is
    silent."""

    name = "list"
    manifest: Manifest = small_manifest(4, 0)
    frames = FrameRange(0)
    play = NO_PLAY
    adaptive = False
    num_layers = 3
    received_bytes = 0
    num_frames = 0

    def __init__(
        self, num_frames: int, failure: Exception | None = None, silent: bool = False
    ) -> None:
        self._packets, self._failure, self._silent = PACKETS[:num_frames], failure, silent
        self._stopped = threading.Event()
        self.passes: Callable[[], None] = lambda: None  # is called before each packet
        self.given = 0
        self.heard: list[ClientStatus] = []

    def packets(self) -> Iterator[Packets]:
        for one in self._packets:
            self.passes()
            self.given += 1
            yield one
        if self._failure is not None:
            raise self._failure
        if self._silent:
            self._stopped.wait()
            raise StoppedError("stopped")

    report_s = REPORT_S

    def send_status(self, status: ClientStatus) -> bool:
        self.heard.append(status)
        return True

    def interrupt(self) -> None:
        self._stopped.set()

    def close(self) -> None:
        pass


class NotingRenderer(CpuRenderer):
    """Records the slices that were put before each drawn frame. draws: is called before it."""

    def __init__(
        self, failure: Exception | None = None, draws: Callable[[int], None] = lambda frame: None
    ) -> None:
        super().__init__(ListSource.manifest)
        self.births: list[int] = []
        self.drawn: list[tuple[int, int]] = []
        self._failure, self._draws = failure, draws

    def put(self, slice: Slice) -> None:
        if self._failure is not None:
            raise self._failure
        self.births.append(slice.birth)

    def upload(self, frame: int) -> None:
        pass

    def render_again(self, frame: int, camera: Camera) -> Floats:
        self._draws(frame)
        self.drawn.append((frame, max(self.births)))
        return np.zeros((2, 2, 3), np.float32)


def run(source: ListSource, renderer: NotingRenderer, events: Events) -> list[FrameRecord]:
    shown: list[FrameRecord] = []
    with Threads(source, events) as threads:
        times = OutputTimes(30.0, 30.0, interpolates=False)

        def show(record: FrameRecord | None, pictures: Iterator[Floats]) -> None:
            assert len(list(pictures)) == (record is not None)
            if record is not None:
                shown.append(record)

        handoff = threads.update(renderer)
        assert render_thread(handoff, renderer, lambda _: CAMERA, times, 0, show) == len(shown)
    return shown


@pytest.fixture(autouse=True)
def _no_thread_is_left() -> Iterator[None]:
    yield
    assert not {*FOLLOWED} & {thread.name for thread in threading.enumerate()}


def test_a_capture_draws_every_frame_once_in_order_with_its_slices() -> None:
    renderer = NotingRenderer()
    shown = run(ListSource(30), renderer, events_of(0.001, Clock(False)))
    assert [record.frame for record in shown] == list(range(30))
    assert renderer.births == list(range(1 - SWIN_SIZE, 30))
    assert [frame for frame, _ in renderer.drawn] == list(range(30))
    # Slices may arrive slightly early, never late.
    assert all(frame <= last <= frame + 3 for frame, last in renderer.drawn)


def test_a_slow_drawer_holds_the_stream_back() -> None:
    source, ahead = ListSource(20), list[int]()
    events = events_of(1000.0, Clock(False), QueueConfig(max_frames=3))

    def is_held() -> bool:
        status = events.client_status(0, 0)
        return status is None or status.busy  # None: all has come

    def draws(frame: int) -> None:
        wait_until(is_held)
        ahead.append(source.given - (frame + 1))

    assert len(run(source, NotingRenderer(draws=draws), events)) == 20
    # 3 in the queue, 3 on their way to the renderer, 1 in the receiver.
    assert 3 < max(ahead) <= 8
    assert events.totals.most_frames_waiting == 3


def test_a_full_queue_stops_the_time_of_a_capture() -> None:
    """A slow machine is not taken for a slow link."""
    world = World()
    clock = Clock(False, world)
    events = events_of(30.0, clock, QueueConfig(max_frames=3))
    with ThreadPoolExecutor(1) as pool:
        coming = [pool.submit(events.append, one) for one in PACKETS[:6]]
        wait_until(lambda: not clock.running)
        world.now_s += 5
        shown = [events.wait_for_frame() for _ in range(6)]
        wait(coming, BOUND_S)
    assert clock.running
    assert clock.now_s() == 0
    assert shown[-1] is not None
    assert shown[-1].record.shown_s == pytest.approx(5 / 30)


def test_a_slow_stream_stalls() -> None:
    world, source = World(), ListSource(6)

    def passes() -> None:
        world.now_s += 0.03

    source.passes = passes
    events = events_of(1000.0, Clock(False, world))
    shown = run(source, NotingRenderer(), events)
    assert events.totals.stalls == 5
    assert events.totals.stalled_s == pytest.approx(5 * 0.029)
    assert events.totals.startup_s == pytest.approx(0.03)
    assert [record.late for record in shown] == [False] + [True] * 5


def fail_to_draw(frame: int) -> None:
    raise SwingsError("the disk is full")


@pytest.mark.parametrize(
    ("source", "renderer", "message"),
    [
        (ListSource(4, SwingsError("no network")), NotingRenderer(), "no network"),
        (ListSource(40, silent=True), NotingRenderer(SwingsError("no memory")), "no memory"),
        (ListSource(40, silent=True), NotingRenderer(draws=fail_to_draw), "the disk is full"),
        (ListSource(0), NotingRenderer(), "ended before its first frame"),
    ],
)
def test_what_breaks_rises_where_frames_are_drawn_and_ends_the_stream(
    source: ListSource, renderer: NotingRenderer, message: str
) -> None:
    with pytest.raises(SwingsError, match=message):
        run(source, renderer, events_of(30.0, Clock(real=False)))


def test_a_window_sees_errors_too_and_takes_all_frames_at_once() -> None:
    handoff = Handoff(max_frames=3)
    for frame in range(3):
        handoff.wait_for_room()
        handoff.put(FrameRecord(frame, 1, 1, 0.0, 0.0))
    assert [record.frame for record in handoff.poll()] == [0, 1, 2]
    assert handoff.poll() == []
    handoff.finish(SwingsError("broken"))
    with pytest.raises(SwingsError, match="broken"):
        handoff.poll()


def test_who_sends_is_told_of_a_full_queue_and_of_a_pause() -> None:
    world, source = World(), ListSource(31, silent=True)
    clock = Clock(True, world)
    events = events_of(1e-3, clock, QueueConfig(max_frames=3))

    def passes() -> None:
        world.now_s += 0.01

    source.passes = passes

    def hears(expected: Callable[[ClientStatus], bool]) -> None:
        wait_until(lambda: source.heard and expected(source.heard[-1]))

    with Threads(source, events):
        # On the time line frame 0 shows, although no thread has taken it.
        hears(lambda one: one == ClientStatus(1, 2000.0, busy=True))
        assert events.wait_for_frame() is not None
        clock.stop()
        events.time_changed()
        hears(lambda one: one.paused and one.busy)
        clock.start()
        events.time_changed()
        hears(lambda one: not one.paused)
