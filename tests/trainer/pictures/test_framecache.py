"""The frame cache: correct pictures at the correct scale, within its bound."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from codec.errors import InvalidError
from tests.support.tiny_capture import picture_of, write_dynamic3dgs, write_dynerf
from trainer.capture.capture import Capture
from trainer.capture.layout import open_capture
from trainer.pictures.framecache import FrameCache
from trainer.pictures.scale import scaled_picture

PICTURE_BYTES = 3 * 32 * 18


@pytest.fixture(scope="module")
def capture(tmp_path_factory: pytest.TempPathFactory) -> Capture:
    root = tmp_path_factory.mktemp("frames") / "c"
    write_dynamic3dgs(root, num_cameras=4, num_frames=6)
    return open_capture(root)


@pytest.fixture
def cache(capture: Capture) -> Iterator[FrameCache]:
    with FrameCache(capture, range(1, 6), 0.5, 4 * PICTURE_BYTES) as cache:
        yield cache


def test_half_size_is_the_mean_of_2x2_pixels(cache: FrameCache) -> None:
    full = picture_of(2, 3).astype(np.float64)
    mean = full.reshape(18, 2, 32, 2, 3).mean(axis=(1, 3))
    got = cache.image(2, 3)
    assert got.shape == (18, 32, 3)
    assert np.abs(got - mean).max() <= 0.5


@pytest.mark.parametrize("scale", [0.3, 0.5, 0.77, 1.0])
def test_camera_and_picture_agree_in_size(capture: Capture, scale: float) -> None:
    with FrameCache(capture, range(6), scale) as cache:
        camera = cache.camera(1)
        assert cache.image(1, 0).shape == (camera.height_px, camera.width_px, 3)
        full = capture.cameras[1].camera
        assert camera.fx_px == pytest.approx(full.fx_px * camera.width_px / full.width_px)
        assert camera.cy_px == pytest.approx(camera.height_px / 2)


def test_area_mean_keeps_a_ramp_in_place(capture: Capture) -> None:
    # Along a ramp over x, every new pixel must show the value at its middle.
    camera = capture.cameras[0].camera.scaled(0.37)
    ramp = np.repeat((np.arange(64, dtype=np.uint8) * 4)[None, :, None], 36, axis=0)
    got = scaled_picture(np.ascontiguousarray(np.repeat(ramp, 3, axis=2)), camera)
    middles = (np.arange(camera.width_px) + 0.5) * 64 / camera.width_px - 0.5
    assert np.abs(got[5, 1:-1, 0] - 4 * middles[1:-1]).max() < 1.5


def test_hits_and_misses(cache: FrameCache) -> None:
    first = cache.image(0, 1)
    assert cache.image(0, 1) is first
    cache.image(1, 1)
    seen = cache.statistics
    assert (seen.hits, seen.misses, seen.evictions) == (1, 2, 0)
    assert seen.held_bytes == 2 * PICTURE_BYTES
    with pytest.raises(ValueError, match="read-only"):
        first[0, 0, 0] = 1


@settings(max_examples=25)
@given(
    asked=st.lists(st.tuples(st.integers(0, 3), st.integers(0, 5)), max_size=40),
    room=st.integers(1, 9),
    spare=st.integers(0, PICTURE_BYTES - 1),
)
def test_the_bound_holds(
    capture: Capture, asked: list[tuple[int, int]], room: int, spare: int
) -> None:
    bound = room * PICTURE_BYTES + spare
    with FrameCache(capture, range(6), 0.5, bound) as cache:
        recent: list[tuple[int, int]] = []
        for camera, frame in asked:
            hits = cache.statistics.hits
            got = cache.image(camera, frame)
            assert abs(int(got[0, 0, 0]) - (20 + 25 * camera)) <= 1
            assert abs(int(got[0, 0, 1]) - (20 + 4 * frame)) <= 1
            assert cache.statistics.held_bytes <= bound
            assert (cache.statistics.hits > hits) == ((camera, frame) in recent)
            recent = [(camera, frame), *[k for k in recent if k != (camera, frame)]][:room]
        seen = cache.statistics
        assert seen.hits + seen.misses == len(asked)


def test_a_window_over_videos_decodes_forward(tmp_path: Path) -> None:
    write_dynerf(tmp_path / "c", num_cameras=2, num_frames=12)
    with FrameCache(open_capture(tmp_path / "c"), range(12)) as cache:
        for start in range(8):
            for frame in range(start, start + 5):
                for camera in range(2):
                    difference = cache.image(camera, frame).astype(int) - picture_of(camera, frame)
                    assert np.abs(difference).max() <= 2
        assert cache.statistics.misses == 24
        cache.close()
        assert cache.statistics.held_bytes == 0
        assert cache.image(1, 11).shape == (36, 64, 3)


def test_many_threads_read_each_picture_once(tmp_path: Path) -> None:
    write_dynerf(tmp_path / "c", num_cameras=2, num_frames=6)
    with FrameCache(open_capture(tmp_path / "c"), range(6)) as cache:
        wrong: list[tuple[int, int]] = []

        def ask(seed: int) -> None:
            rng = np.random.default_rng(seed)
            for _ in range(30):
                camera, frame = int(rng.integers(2)), int(rng.integers(6))
                got = cache.image(camera, frame).astype(int)
                if np.abs(got - picture_of(camera, frame)).max() > 2:
                    wrong.append((camera, frame))

        threads = [threading.Thread(target=ask, args=(seed,)) for seed in range(4)]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
        assert not wrong
        assert cache.statistics.misses <= 12


def test_bad_arguments_are_refused(capture: Capture, cache: FrameCache) -> None:
    for scale in (0.0, -1.0, 1.5, float("nan")):
        with pytest.raises(InvalidError, match="scale"):
            FrameCache(capture, range(6), scale)
    for frames in (range(0), range(7), range(-1, 3), range(0, 6, 2)):
        with pytest.raises(InvalidError, match="frames"):
            FrameCache(capture, frames)
    with pytest.raises(InvalidError, match="one picture takes"):
        FrameCache(capture, range(6), 1.0, 100)
    with pytest.raises(InvalidError, match="outside 1:6"):
        cache.image(0, 0)
