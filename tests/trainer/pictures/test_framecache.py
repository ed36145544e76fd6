"""The frame cache: correct pictures, within its bound, read ahead; and shots of it."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from codec.errors import InvalidError
from tests.support.hostile import refused
from tests.support.tiny_capture import picture_of, write_dynamic3dgs, write_dynerf
from tests.support.waiting import BOUND_S, wait_until
from trainer.capture.capture import Capture, Picture, PictureSource
from trainer.capture.layout import open_capture
from trainer.capture.video import VideoSource
from trainer.errors import CaptureError
from trainer.pictures.framecache import CacheStatistics, CapturePictures, FrameCache, Prefetcher
from trainer.pictures.scale import Shot, scaled_mask, scaled_picture

FRAMES = 8
PICTURE_BYTES = 3 * 64 * 36
HALF_BYTES = PICTURE_BYTES // 4


@pytest.fixture(scope="module")
def capture(tmp_path_factory: pytest.TempPathFactory) -> Capture:
    root = tmp_path_factory.mktemp("frames") / "c"
    write_dynamic3dgs(root, num_cameras=4, num_frames=FRAMES)
    return open_capture(root)


def assert_shows(cache: FrameCache, camera: int, frame: int) -> None:
    """Asserts that a picture is the right one, except for rounding to a video's colours."""
    difference = cache.image(camera, frame).astype(int) - picture_of(camera, frame)
    assert np.abs(difference).max() <= 2


@pytest.mark.parametrize("scale", [0.3, 0.5, 0.77, 1.0])
def test_camera_and_picture_agree_in_size(capture: Capture, scale: float) -> None:
    with FrameCache(capture, range(FRAMES), scale) as cache:
        camera, picture = cache.camera(1), cache.image(1, 3)
    assert picture.shape == (camera.height_px, camera.width_px, 3)
    full = capture.cameras[1].camera
    assert camera.fx_px == pytest.approx(full.fx_px * camera.width_px / full.width_px)
    assert camera.cy_px == pytest.approx(camera.height_px / 2)
    if scale == 0.5:
        mean = picture_of(1, 3).astype(np.float64).reshape(18, 2, 32, 2, 3).mean(axis=(1, 3))
        assert np.abs(picture - mean).max() <= 0.5


def test_area_mean_keeps_a_ramp_in_place(capture: Capture) -> None:
    # Along a ramp over x, every new pixel must show the value at its middle.
    camera = capture.cameras[0].camera.scaled(0.37)
    ramp = np.empty((36, 64, 3), np.uint8)
    ramp[:] = 4 * np.arange(64)[:, None]
    middles = (np.arange(camera.width_px) + 0.5) * 64 / camera.width_px - 0.5
    got = scaled_picture(ramp, camera)[5, 1:-1, 0]
    assert np.abs(got - 4 * middles[1:-1]).max() < 1.5


@settings(max_examples=25)
@given(
    asked=st.lists(st.tuples(st.integers(0, 3), st.integers(0, 5)), max_size=40),
    room=st.integers(1, 9),
    spare=st.integers(0, HALF_BYTES - 1),
)
def test_the_bound_holds(
    capture: Capture, asked: list[tuple[int, int]], room: int, spare: int
) -> None:
    bound = room * HALF_BYTES + spare
    with FrameCache(capture, range(FRAMES), 0.5, bound) as cache:
        recent: list[tuple[int, int]] = []
        for camera, frame in asked:
            hits = cache.statistics.hits
            got = cache.image(camera, frame)
            assert not got.flags.writeable
            assert abs(int(got[0, 0, 0]) - (20 + 25 * camera)) <= 1
            assert abs(int(got[0, 0, 1]) - (20 + 4 * frame)) <= 1
            assert cache.statistics.held_bytes <= bound
            assert (cache.statistics.hits > hits) == ((camera, frame) in recent)
            recent = [(camera, frame), *[k for k in recent if k != (camera, frame)]][:room]
        seen = cache.statistics
        assert seen.hits + seen.misses == len(asked)
        assert seen.held_bytes == len(recent) * HALF_BYTES
        assert seen.evictions == seen.misses - len(recent)


def test_many_threads_read_each_picture_once(tmp_path: Path) -> None:
    write_dynerf(tmp_path / "c", num_cameras=2, num_frames=6)
    with FrameCache(open_capture(tmp_path / "c"), range(6)) as cache, ThreadPoolExecutor(4) as pool:

        def ask(seed: int) -> None:
            rng = np.random.default_rng(seed)
            for _ in range(30):
                camera, frame = int(rng.integers(2)), int(rng.integers(6))
                assert_shows(cache, camera, frame)

        list(pool.map(ask, range(4)))
        assert cache.statistics.misses <= 12


def test_bad_arguments_are_refused(capture: Capture) -> None:
    for scale in (0.0, -1.0, 1.5, float("nan")):
        refused(InvalidError, "scale", FrameCache, capture, range(FRAMES), scale)
    for frames in (range(0), range(9), range(-1, 3), range(0, 8, 2)):
        refused(InvalidError, "frames", FrameCache, capture, frames)
    refused(InvalidError, "one picture takes", FrameCache, capture, range(FRAMES), 1.0, 100)
    with FrameCache(capture, range(1, 6)) as cache:
        refused(InvalidError, "outside 1:6", cache.image, 0, 0)
        refused(InvalidError, "outside 1:6", cache.prefetch, range(4), 6, 1)


@pytest.mark.parametrize("size", [(12, 18), (13, 18), (12, 19), (13, 19)])
def test_half_a_shot_is_the_unrounded_means_of_2x2_pixels(size: tuple[int, int]) -> None:
    rng = np.random.default_rng(0)
    picture = rng.integers(0, 256, (*size, 3), dtype=np.uint8)
    mask = (rng.random(size) > 0.2).astype(np.uint8)
    whole = Shot(picture, mask)
    half = whole.half()
    assert whole.shape == size
    assert half.shape == (6, 9)
    assert half.picture is picture  # a training step makes no copy
    assert np.array_equal(half.mask, scaled_mask(mask[:12, :18], 9, 6))  # type: ignore[arg-type]
    assert Shot(picture).half().mask is None
    planes = np.empty((3, *half.shape), np.float32)
    half.fill(planes)
    sums = picture[:12, :18].reshape(6, 2, 9, 2, 3).sum(axis=(1, 3), dtype=np.float32)
    assert np.array_equal(planes, (np.float32(0.25 / 255) * sums).transpose(2, 0, 1))
    planes = np.empty((3, *size), np.float32)
    whole.fill(planes)
    assert np.array_equal(
        planes, (np.float32(1 / 255) * picture.astype(np.float32)).transpose(2, 0, 1)
    )


def test_training_sees_the_training_cameras_from_frame_0_on(capture: Capture) -> None:
    assert capture.training == (0, 2, 3)
    with FrameCache(capture, range(2, 5)) as cache:
        pictures = CapturePictures(cache, capture.training)
        assert pictures.num_frames == 3
        assert [c.name for c in pictures.cameras] == ["cam00", "cam02", "cam03"]
        shot = pictures.shot(1, 2)
        assert shot.picture is cache.image(2, 4)
        assert shot.mask is None is pictures.mask(1, 2)


class Gate:
    """Sources that record reads and wait for the gate to open."""

    def __init__(self, capture: Capture) -> None:
        self.open, self.reading = threading.Event(), threading.Event()
        self.read: list[tuple[int, int]] = []
        self.capture = replace(capture, opener=lambda i: Gated(self, i, capture.open_images(i)))


class Gated:
    def __init__(self, gate: Gate, index: int, inner: PictureSource) -> None:
        self._gate, self._index, self._inner = gate, index, inner
        self.close = inner.close

    def read(self, frame: int) -> Picture:
        self._gate.read.append((self._index, frame))
        self._gate.reading.set()
        assert self._gate.open.wait(BOUND_S)
        return self._inner.read(frame)


@pytest.fixture
def gate(capture: Capture) -> Iterator[Gate]:
    gate = Gate(capture)
    yield gate
    gate.open.set()


def until(cache: FrameCache, done: Callable[[CacheStatistics], bool]) -> CacheStatistics:
    """Waits until the statistics are `done`; returns them."""
    wait_until(lambda: done(cache.statistics))
    return cache.statistics


def test_what_finds_too_many_waiting_is_dropped_and_counted(gate: Gate) -> None:
    with FrameCache(gate.capture, range(FRAMES), max_requests=3) as cache:
        cache.prefetch([0], 0, 0)
        assert gate.reading.wait(BOUND_S)  # it runs, nothing waits
        cache.prefetch([0, 1, 2, 3], 1, 0)
        cache.prefetch([0, 1], 2, 0)
        assert cache.statistics.prefetch_dropped == 3
        gate.open.set()
        until(cache, lambda s: s.prefetched == 4)
        assert gate.read == [(0, 0), (0, 1), (1, 1), (2, 1)]
        assert np.array_equal(cache.image(3, 1), picture_of(3, 1))


def test_a_closed_queue_ends_its_thread_drops_what_waits_and_may_be_used_again() -> None:
    opened, working, done = threading.Event(), threading.Event(), list[int]()

    def do(job: int) -> None:
        working.set()
        assert opened.wait(BOUND_S)
        done.append(job)

    def threads() -> list[threading.Thread]:
        return [t for t in threading.enumerate() if t.name == "prefetch"]

    line = Prefetcher(do, 3)
    line.close()  # nothing has started, so there is nothing to end
    assert line.ask(0)
    assert working.wait(BOUND_S)
    assert [line.ask(job) for job in range(1, 5)] == [True, True, True, False]
    (thread,) = threads()
    closer = threading.Thread(target=line.close)
    closer.start()
    wait_until(lambda: line.ask(99))  # once those that wait are dropped; a new thread does it
    opened.set()
    closer.join(BOUND_S)
    assert not thread.is_alive()
    wait_until(lambda: sorted(done) == [0, 99])
    line.close()
    assert not threads()


def test_nothing_that_is_needed_goes(capture: Capture) -> None:
    gate = Gate(capture)
    gate.open.set()
    with FrameCache(gate.capture, range(FRAMES), max_bytes=4 * PICTURE_BYTES + 7) as cache:

        def ask(*frames: int) -> None:
            for frame in frames:
                for camera in (0, 1):
                    cache.image(camera, frame)

        ask(1, 2)
        cache.prefetch([0, 1], 3, 1)
        until(cache, lambda s: s.prefetch_skipped == 2)
        assert (0, 3) not in gate.read  # not even read: a video would have to seek back
        ask(1, 2)
        assert cache.statistics.hits == 4
        # Frame 1 is past: its pictures are evicted, although frame 2's were used earlier.
        ask(1)
        cache.prefetch([0, 1, 2], 3, 2)
        seen = until(cache, lambda s: s.prefetched == 2 and s.prefetch_skipped == 3)
        assert (seen.evictions, seen.held_bytes) == (2, 4 * PICTURE_BYTES)
        ask(2, 3)
        assert cache.statistics.hits == seen.hits + 4


def test_the_bound_holds_while_others_read_and_a_closed_cache_can_be_used(capture: Capture) -> None:
    bound = 5 * PICTURE_BYTES
    with FrameCache(capture, range(FRAMES), max_bytes=bound) as cache:
        rng = np.random.default_rng(2)
        for _ in range(200):
            camera, frame = int(rng.integers(4)), int(rng.integers(FRAMES))
            cache.prefetch(range(4), int(rng.integers(FRAMES)), int(rng.integers(FRAMES)))
            assert np.array_equal(cache.image(camera, frame), picture_of(camera, frame))
            assert cache.statistics.held_bytes <= bound
        before = cache.statistics.prefetched
        assert before > 0
        cache.close()
        assert cache.statistics.held_bytes == 0
        cache.prefetch([2], 3, 0)
        until(cache, lambda s: s.prefetched > before)


def test_an_error_reaches_who_asks_for_the_picture(tmp_path: Path) -> None:
    write_dynamic3dgs(tmp_path / "c", num_cameras=4, num_frames=3)
    (tmp_path / "c/ims/2/000001.png").write_bytes(b"none")
    with FrameCache(open_capture(tmp_path / "c"), range(3)) as cache:
        cache.prefetch(range(4), 1, 0)
        until(cache, lambda s: s.prefetched == 3 and s.prefetch_failed == 1)
        refused(CaptureError, "000001", cache.image, 2, 1)
        cache.prefetch([2], 2, 0)  # the thread is still running
        until(cache, lambda s: s.prefetched == 4)


def test_videos_are_read_forward_once(tmp_path: Path) -> None:
    """Like the job: the frames of a window in any order, with the next frame read ahead."""
    length, window = 25, 3
    write_dynerf(tmp_path / "c", num_cameras=2, num_frames=length)
    opened = open_capture(tmp_path / "c")
    sources: dict[int, PictureSource] = {}

    def open_images(index: int) -> PictureSource:
        return sources.setdefault(index, opened.open_images(index))

    rng = np.random.default_rng(0)
    capture = replace(opened, opener=open_images)
    room = 2 * (window + 1) * PICTURE_BYTES
    with FrameCache(capture, range(length), max_bytes=room) as cache:
        for frame in range(window):
            cache.prefetch(range(2), frame, 0)
        for first in range(length - window + 1):
            wait_until(lambda done=2 * (first + window): cache.statistics.prefetched == done)
            if first + window < length:
                cache.prefetch(range(2), first + window, first)
            for _ in range(20):
                camera, frame = int(rng.integers(2)), int(rng.integers(first, first + window))
                assert_shows(cache, camera, frame)
        assert (cache.statistics.misses, cache.statistics.prefetch_skipped) == (0, 0)
        for source in sources.values():
            assert isinstance(source, VideoSource)
            assert source.decoded_frames == length
