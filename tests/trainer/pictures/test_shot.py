"""A picture and its mask stay together, at full and at half size."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from tests.support.tiny_capture import write_dynamic3dgs
from trainer.capture.layout import open_capture
from trainer.pictures.feed import CapturePictures
from trainer.pictures.framecache import FrameCache
from trainer.pictures.scale import half_mask
from trainer.pictures.shot import Shot


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


def test_training_sees_the_training_cameras_from_frame_0_on(tmp_path: Path) -> None:
    write_dynamic3dgs(tmp_path / "c", num_cameras=4, num_frames=5)
    capture = open_capture(tmp_path / "c")
    assert capture.training == (0, 2, 3)
    with FrameCache(capture, range(2, 5)) as cache:
        pictures = CapturePictures(cache, capture.training)
        assert pictures.num_frames == 3
        assert [c.name for c in pictures.cameras] == [
            capture.cameras[i].camera.name for i in capture.training
        ]
        shot = pictures.shot(1, 2)
        assert shot.picture is cache.image(2, 4)
        assert shot.mask is None is pictures.mask(1, 2)
