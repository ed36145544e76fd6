"""The threads of Algorithm 2: in order, bounded, and down together."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator

import numpy as np
import numpy.typing as npt
import pytest

from codec.camera import Camera
from codec.errors import CodecError, SwingsError
from codec.framerange import FrameRange
from codec.slice import Slice
from codec.stream.chunk import encode_chunk
from codec.stream.layers import opacity_rank, split_layers
from codec.stream.manifest import Manifest, Part
from codec.stream.object import encode_packet
from player.network.fetch import StoppedError
from player.playout.clock import Clock
from player.playout.queues import EmptyStreamError, Events, Handoff
from player.playout.threads import Threads, render_thread
from player.playout.timeline import FrameRecord, Playout, QueueConfig
from player.render.steptimes import StepTimes
from player.source.source import NO_PLAY, Packets, SlicePackets
from server.abr.playout import PlayoutConfig
from server.abr.standing import Standing
from tests.support.hosted_streams import SWIN_SIZE, random_slice, small_manifest

pytestmark = pytest.mark.realtime

CAMERA = small_manifest().camera()
MANIFEST = small_manifest(4, 0)
AT_ONCE = PlayoutConfig(start_lead_s=0, resume_lead_s=0)


def blame(error: CodecError, part: Part) -> CodecError:
    return error.within(f"list: {part}")


def packets(birth: int) -> SlicePackets:
    layers = split_layers(random_slice(birth, 4, 0), MANIFEST.layers, opacity_rank)
    chunk = encode_chunk(layers[0], 0, MANIFEST.profile)
    return SlicePackets(birth, 0, (encode_packet(chunk),), None, blame)


def playout_of(fps: float, queue: QueueConfig | None = None) -> Playout:
    return Playout(small_manifest(4, 0, fps), 0, None, queue, AT_ONCE)


class ListSource:
    """Slices from a list, then an error if there is one, or endless silence."""

    def __init__(
        self,
        num_slices: int,
        gap_s: float = 0.0,
        failure: Exception | None = None,
        silent: bool = False,
    ) -> None:
        self._num_slices, self._gap_s = num_slices, gap_s
        self._failure, self._silent = failure, silent
        self._stopped = threading.Event()
        self.given = 0
        self.heard: list[Standing] = []

    name = "list"
    manifest: Manifest = MANIFEST
    frames = FrameRange(0)
    play = NO_PLAY
    adaptive = False
    num_layers = 3
    received_bytes = 0
    num_frames = 0

    def packets(self) -> Iterator[Packets]:
        for birth in range(1 - SWIN_SIZE, 1 - SWIN_SIZE + self._num_slices):
            time.sleep(self._gap_s)
            self.given += 1
            yield packets(birth)
        if self._failure is not None:
            raise self._failure
        if self._silent:
            self._stopped.wait()
            raise StoppedError("stopped")

    def tell(self, standing: Standing) -> bool:
        self.heard.append(standing)
        return True

    def interrupt(self) -> None:
        self._stopped.set()

    def close(self) -> None:
        pass


class NotingRenderer:
    """Notes what was put before each frame was drawn."""

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
        render_thread(handoff, renderer, lambda _: CAMERA, lambda r, _: shown.append(r))
    return shown, events


def no_threads_left() -> bool:
    return not {"receive", "tell", "update"} & {thread.name for thread in threading.enumerate()}


def test_a_capture_draws_every_frame_once_in_order_with_its_slices() -> None:
    renderer = NotingRenderer()
    shown, _ = run(ListSource(SWIN_SIZE + 29), renderer, fps=0.001)
    assert [record.frame for record in shown] == list(range(30))
    assert renderer.births == list(range(1 - SWIN_SIZE, 30))
    assert [frame for frame, _ in renderer.drawn] == list(range(30))
    # Slices may be there a little early, never late.
    assert all(frame <= last <= frame + 3 for frame, last in renderer.drawn)
    assert no_threads_left()


def test_a_slow_drawer_holds_the_stream_back_and_is_not_a_stall() -> None:
    source, renderer = ListSource(SWIN_SIZE + 19), NotingRenderer(draw_s=0.02)
    ahead: list[int] = []
    draw = renderer.render

    def noting(frame: int, camera: Camera) -> npt.NDArray[np.float32]:
        ahead.append(source.given - (frame + SWIN_SIZE))
        return draw(frame, camera)

    renderer.render = noting  # type: ignore[method-assign]
    # The machine draws 50 frames a second, the stream has 1000.
    shown, events = run(source, renderer, fps=1000.0, queue=QueueConfig(max_frames=3))
    assert len(shown) == 20
    # Queue 3, on their way to the renderer 3, in the hand of the receiver 1.
    assert max(ahead) <= 8
    assert events.totals.most_frames_waiting <= 3
    assert events.totals.stalled_s < 0.1


def test_with_a_real_clock_frames_wait_until_they_are_due() -> None:
    began_s = time.monotonic()
    shown, events = run(ListSource(SWIN_SIZE + 9), NotingRenderer(), real=True, fps=30.0)
    assert time.monotonic() - began_s >= 9 / 30
    assert len(shown) == 10
    assert events.totals.stalls == 0


def test_a_slow_stream_stalls() -> None:
    shown, events = run(ListSource(SWIN_SIZE + 5, gap_s=0.03), NotingRenderer(), fps=1000.0)
    assert events.totals.stalls == 5
    assert events.totals.stalled_s == pytest.approx(5 * 0.03, rel=0.5)
    assert events.totals.startup_s >= SWIN_SIZE * 0.03
    assert [record.late for record in shown] == [False] + [True] * 5


@pytest.mark.parametrize("real", [True, False])
def test_what_breaks_the_stream_rises_where_frames_are_drawn(real: bool) -> None:
    with pytest.raises(SwingsError, match="the network is gone"):
        run(
            ListSource(SWIN_SIZE + 3, failure=SwingsError("the network is gone")),
            NotingRenderer(),
            real=real,
        )
    assert no_threads_left()


def test_what_breaks_the_renderer_rises_and_ends_the_stream() -> None:
    source = ListSource(1000, silent=True)
    with pytest.raises(SwingsError, match="no memory"):
        run(source, NotingRenderer(failure=SwingsError("no memory")))
    assert no_threads_left()


def test_what_breaks_the_drawing_ends_both_threads() -> None:
    renderer = NotingRenderer()

    def broken(frame: int, camera: Camera) -> npt.NDArray[np.float32]:
        raise SwingsError("the disk is full")

    renderer.render = broken  # type: ignore[method-assign]
    with pytest.raises(SwingsError, match="the disk is full"):
        run(ListSource(SWIN_SIZE + 2, silent=True), renderer)
    assert no_threads_left()


def test_a_stream_that_ends_before_its_first_frame_is_an_error() -> None:
    with pytest.raises(EmptyStreamError):
        run(ListSource(SWIN_SIZE - 1), NotingRenderer())


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
    for birth in range(1 - SWIN_SIZE, 2):
        events.append(packets(birth))
    assert events.take() is not None
    pause(events, clock)
    threading.Timer(0.2, go_on, (events, clock)).start()
    began_s = time.monotonic()
    assert events.take() is not None
    assert time.monotonic() - began_s >= 0.2


def test_who_sends_is_told_of_a_full_queue_and_of_a_pause() -> None:
    def heard(expected: Callable[[Standing], bool]) -> None:
        for _ in range(2000):
            if source.heard and expected(source.heard[-1]):
                return
            time.sleep(0.01)
        raise AssertionError(f"{source.heard[-3:]}")

    source = ListSource(SWIN_SIZE + 30, silent=True)
    clock = Clock(real=True)
    events = Events(playout_of(1e-3, QueueConfig(max_frames=3)), clock)
    with Threads(source, events):
        # By the time line frame 0 shows, though nobody has taken it.
        heard(lambda one: one == Standing(1, 2000.0, busy=True))
        assert events.take() is not None
        pause(events, clock)
        heard(lambda one: one.paused and one.busy)
        go_on(events, clock)
        heard(lambda one: not one.paused)
    assert no_threads_left()
