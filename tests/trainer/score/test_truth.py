"""Scores use the picture sizes of the training, and only the stream's own capture."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from codec.stream.manifest import Manifest
from tests.support.tiny_capture import write_dynamic3dgs
from tests.support.tiny_stream import tiny_manifest
from trainer.capture.capture import Capture
from trainer.capture.layout import open_capture
from trainer.errors import CaptureError
from trainer.pictures.framecache import FrameCache
from trainer.score.truth import stream_cameras

SCALE = 0.3


@pytest.fixture(scope="module")
def capture(tmp_path_factory: pytest.TempPathFactory) -> Capture:
    """Cameras of 64, 51 and 33 pixels in width, which 0.3 does not divide."""
    root = tmp_path_factory.mktemp("evaluate") / "c"
    write_dynamic3dgs(root, num_cameras=4, num_frames=3)
    plain = open_capture(root)
    sizes = [(64, 36), (51, 29), (33, 19), (64, 36)]
    cameras = [
        replace(c, camera=c.camera.resized(*size), held_out=True)
        for c, size in zip(plain.cameras, sizes, strict=True)
    ]
    return replace(plain, cameras=tuple(cameras))


def trained(capture: Capture) -> Manifest:
    cameras = tuple(c.camera.scaled(SCALE) for c in capture.cameras)
    return replace(tiny_manifest(), cameras=cameras, default_camera=cameras[0].name)


def test_every_camera_has_the_size_that_training_gave_it(capture: Capture) -> None:
    manifest = trained(capture)
    cameras = stream_cameras(manifest, capture, "stream")
    sizes = [(c.width_px, c.height_px) for c in cameras]
    with FrameCache(capture, range(3), SCALE) as cache:
        assert sizes == [
            (cache.camera(i).width_px, cache.camera(i).height_px) for i in range(len(cameras))
        ]
    with FrameCache(capture, range(3), cameras=cameras) as cache:
        assert cache.camera(1) == cameras[1]
        assert cache.image(0, 0).shape == (cameras[0].height_px, cameras[0].width_px, 3)


@pytest.mark.parametrize("index", [0, 2])
def test_another_capture_is_told_by_any_held_out_camera(capture: Capture, index: int) -> None:
    manifest = trained(capture)
    cameras = list(manifest.cameras)
    w2c = cameras[index].w2c.copy()
    w2c[:3, 3] += 0.1
    cameras[index] = replace(cameras[index], w2c=w2c)
    with pytest.raises(CaptureError, match=f"camera {cameras[index].name} is not the one"):
        stream_cameras(replace(manifest, cameras=tuple(cameras)), capture, "stream")
    cameras[index] = replace(cameras[index], w2c=np.eye(4), name="other")
    others = replace(manifest, cameras=tuple(cameras), default_camera="other")
    with pytest.raises(CaptureError, match="has no camera"):
        stream_cameras(others, capture, "stream")
