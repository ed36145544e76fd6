"""The threads of Algorithm 2: in order, with bounded queues, and ending together."""

from __future__ import annotations

import tempfile
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pytest

from codec.camera import Camera
from codec.errors import SwingsError
from codec.framerange import FrameRange
from codec.slice import Slice
from codec.stream.manifest import Manifest
from player.network.fetch import StoppedError
from player.playout.clock import Clock
from player.playout.outputtimes import OutputTimes
from player.playout.queues import EmptyStreamError, Events, Handoff
from player.playout.threads import Threads, render_thread
from player.playout.timeline import FrameRecord, Playout, QueueConfig
from player.render.steptimes import StepTimes
from player.source.directory import DirectorySource
from player.source.source import NO_PLAY, Packets
from server.abr.clientstatus import ClientStatus
from server.abr.playout import PlayoutConfig
from tests.support.hosted_streams import SWIN_SIZE, small_manifest, write_stream

pytestmark = pytest.mark.realtime

CAMERA = small_manifest().camera()
MANIFEST = small_manifest(4, 0)
AT_ONCE = PlayoutConfig(start_lead_s=0, resume_lead_s=0)


def packets_of_frames(count: int) -> list[Packets]:
    """Layer 0 of frames 0 to count-1: a snapshot for the first, slices for the others."""
    with tempfile.TemporaryDirectory() as folder:
        path = write_stream(Path(folder) / "s", count, 4, 0)
        return list(DirectorySource(path, FrameRange(), 1).packets())


PACKETS = packets_of_frames(40)


def playout_of(fps: float, queue: QueueConfig | None = None) -> Playout:
    return Playout(small_manifest(4, 0, fps), 0, None, queue, AT_ONCE)


class ListSource:
    """Packets from a list, then an error if there is one, else nothing forever."""

    def __init__(
        self,
        num_frames: int,
        gap_s: float = 0.0,
        failure: Exception | None = None,
        silent: bool = False,
    ) -> None:
        self._packets, self._gap_s = PACKETS[:num_frames], gap_s
        self._failure, self._silent = failure, silent
        self._stopped = threading.Event()
        self.given = 0
        self.heard: list[ClientStatus] = []

    name = "list"
    manifest: Manifest = MANIFEST
    frames = FrameRange(0)
    play = NO_PLAY
    adaptive = False
    num_layers = 3
    received_bytes = 0
    num_frames = 0

    def packets(self) -> Iterator[Packets]:
        for one in self._packets:
            time.sleep(self._gap_s)
            self.given += 1
            yield one
        if self._failure is not None:
            raise self._failure
        if self._silent:
            self._stopped.wait()
            raise StoppedError("stopped")

    def send_status(self, status: ClientStatus) -> bool:
        self.heard.append(status)
        return True

    def interrupt(self) -> None:
        self._stopped.set()

    def close(self) -> None:
        pass


class NotingRenderer:
    """Records the slices that were put before each drawn frame."""

    name = "notes"
    uploaded_bytes = 0
    times: StepTimes | None = None
    alpha = False

    def __init__(self, failure: Exception | None = None, draw_s: float = 0.0) -> None:
        self.births: list[int] = []
        self.drawn: list[tuple[int, int]] = []
        self._failure, self._draw_s = failure, draw_s

    def glide(self, share: float) -> bool:
        return False

    def put(self, slice: Slice) -> None:
        if self._failure is not None:
            raise self._failure
        self.births.append(slice.birth)

    def forget_waiting(self) -> None:
        pass

    def upload(self, frame: int) -> None:
        pass

    def render(self, frame: int, camera: Camera) -> npt.NDArray[np.float32]:
        return self.render_again(frame, camera)

    def render_again(self, frame: int, camera: Camera) -> npt.NDArray[np.float32]:
        time.sleep(self._draw_s)
        self.drawn.append((frame, max(self.births)))
        return np.zeros((2, 2, 3), np.float32)

    def close(self) -> None:
        pass


def run(
    source: ListSource,
    renderer: NotingRenderer,
    *,
    real: bool = False,
    fps: float = 30.0,
    queue: QueueConfig | None = None,
) -> tuple[list[FrameRecord], Events]:
    events = Events(playout_of(fps, queue), Clock(real))
    shown: list[FrameRecord] = []
    with Threads(source, events) as threads:
        handoff = threads.update(renderer)
        times = OutputTimes(fps, fps, interpolates=False)

        def show(record: FrameRecord | None, pictures: Iterator[npt.NDArray[np.float32]]) -> None:
            assert len(list(pictures)) == (record is not None)
            if record is not None:
                shown.append(record)

        assert render_thread(handoff, renderer, lambda _: CAMERA, times, 0, show) == len(shown)
    return shown, events


def no_threads_left() -> bool:
    return not {"receive", "status", "update"} & {thread.name for thread in threading.enumerate()}


def test_a_capture_draws_every_frame_once_in_order_with_its_slices() -> None:
    renderer = NotingRenderer()
    shown, _ = run(ListSource(30), renderer, fps=0.001)
    assert [record.frame for record in shown] == list(range(30))
    assert renderer.births == list(range(1 - SWIN_SIZE, 30))
    assert [frame for frame, _ in renderer.drawn] == list(range(30))
    # Slices may arrive slightly early, never late.
    assert all(frame <= last <= frame + 3 for frame, last in renderer.drawn)
    assert no_threads_left()


def test_a_slow_drawer_holds_the_stream_back_and_is_not_a_stall() -> None:
    source, renderer = ListSource(20), NotingRenderer(draw_s=0.02)
    ahead: list[int] = []
    draw = renderer.render_again

    def noting(frame: int, camera: Camera) -> npt.NDArray[np.float32]:
        ahead.append(source.given - (frame + 1))
        return draw(frame, camera)

    renderer.render_again = noting  # type: ignore[method-assign]
    # The machine draws 50 frames a second, the stream has 1000.
    shown, events = run(source, renderer, fps=1000.0, queue=QueueConfig(max_frames=3))
    assert len(shown) == 20
    # 3 in the queue, 3 on their way to the renderer, 1 in the receiver.
    assert max(ahead) <= 8
    assert events.totals.most_frames_waiting <= 3
    assert events.totals.stalled_s < 0.1


def test_with_a_real_clock_frames_wait_until_they_are_due() -> None:
    began_s = time.monotonic()
    shown, events = run(ListSource(10), NotingRenderer(), real=True, fps=30.0)
    assert time.monotonic() - began_s >= 9 / 30
    assert len(shown) == 10
    assert events.totals.stalls == 0


def test_a_slow_stream_stalls() -> None:
    shown, events = run(ListSource(6, gap_s=0.03), NotingRenderer(), fps=1000.0)
    assert events.totals.stalls == 5
    assert events.totals.stalled_s == pytest.approx(5 * 0.03, rel=0.5)
    assert events.totals.startup_s >= 0.03
    assert [record.late for record in shown] == [False] + [True] * 5


@pytest.mark.parametrize("real", [True, False])
def test_what_breaks_the_stream_rises_where_frames_are_drawn(real: bool) -> None:
    with pytest.raises(SwingsError, match="the network is gone"):
        run(
            ListSource(4, failure=SwingsError("the network is gone")),
            NotingRenderer(),
            real=real,
        )
    assert no_threads_left()


def test_what_breaks_the_renderer_rises_and_ends_the_stream() -> None:
    source = ListSource(40, silent=True)
    with pytest.raises(SwingsError, match="no memory"):
        run(source, NotingRenderer(failure=SwingsError("no memory")))
    assert no_threads_left()


def test_what_breaks_the_drawing_ends_both_threads() -> None:
    renderer = NotingRenderer()

    def broken(frame: int, camera: Camera) -> npt.NDArray[np.float32]:
        raise SwingsError("the disk is full")

    renderer.render_again = broken  # type: ignore[method-assign]
    with pytest.raises(SwingsError, match="the disk is full"):
        run(ListSource(3, silent=True), renderer)
    assert no_threads_left()


def test_a_stream_that_ends_before_its_first_frame_is_an_error() -> None:
    with pytest.raises(EmptyStreamError):
        run(ListSource(0), NotingRenderer())


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


def pause(events: Events, clock: Clock) -> None:
    clock.stop()
    events.time_changed()


def go_on(events: Events, clock: Clock) -> None:
    clock.start()
    events.time_changed()


def test_a_pause_stops_the_time() -> None:
    clock = Clock(real=True)
    events = Events(playout_of(100.0), clock)
    for one in PACKETS[:2]:
        events.append(one)
    assert events.wait_for_frame() is not None
    pause(events, clock)
    threading.Timer(0.2, go_on, (events, clock)).start()
    began_s = time.monotonic()
    assert events.wait_for_frame() is not None
    assert time.monotonic() - began_s >= 0.2


def test_who_sends_is_told_of_a_full_queue_and_of_a_pause() -> None:
    def heard(expected: Callable[[ClientStatus], bool]) -> None:
        for _ in range(2000):
            if source.heard and expected(source.heard[-1]):
                return
            time.sleep(0.01)
        raise AssertionError(f"{source.heard[-3:]}")

    source = ListSource(31, silent=True)
    clock = Clock(real=True)
    events = Events(playout_of(1e-3, QueueConfig(max_frames=3)), clock)
    with Threads(source, events):
        # On the time line frame 0 shows, although no thread has taken it.
        heard(lambda one: one == ClientStatus(1, 2000.0, busy=True))
        assert events.wait_for_frame() is not None
        pause(events, clock)
        heard(lambda one: one.paused and one.busy)
        go_on(events, clock)
        heard(lambda one: not one.paused)
    assert no_threads_left()
