"""The frame cache: correct pictures at the correct scale, within its bound; and shots, in which a
picture and its mask stay together."""

from __future__ import annotations

from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from codec.errors import InvalidError
from tests.support.tiny_capture import picture_of, write_dynamic3dgs, write_dynerf
from trainer.capture.capture import Capture
from trainer.capture.layout import open_capture
from trainer.pictures.feed import CapturePictures
from trainer.pictures.framecache import FrameCache
from trainer.pictures.scale import half_mask, scaled_picture
from trainer.pictures.shot import Shot

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


@pytest.mark.parametrize("scale", [0.3, 0.5, 0.77, 1.0])
def test_camera_and_picture_agree_in_size(capture: Capture, scale: float) -> None:
    with FrameCache(capture, range(6), scale) as cache:
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
    with FrameCache(open_capture(tmp_path / "c"), range(6)) as cache, ThreadPoolExecutor(4) as pool:

        def ask(seed: int) -> None:
            rng = np.random.default_rng(seed)
            for _ in range(30):
                camera, frame = int(rng.integers(2)), int(rng.integers(6))
                difference = cache.image(camera, frame).astype(int) - picture_of(camera, frame)
                assert np.abs(difference).max() <= 2

        list(pool.map(ask, range(4)))
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
    assert np.array_equal(half.mask, half_mask(mask))  # type: ignore[arg-type]
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
