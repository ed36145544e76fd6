"""The EasyMocap layout: OpenCV's matrices, of pictures or videos, and refusals."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np

from tests.support.tiny_capture import picture_of, refusal
from tests.support.tiny_models import write_easymocap
from trainer.capture.layout import open_capture


def test_pictures_as_written(tmp_path: Path) -> None:
    written = write_easymocap(tmp_path, 3, 4)
    capture = open_capture(tmp_path)
    assert (capture.layout, capture.num_frames, capture.fps) == ("easymocap", 4, None)
    for index, (entry, camera) in enumerate(zip(capture.cameras, written, strict=True)):
        assert entry.camera.name == camera.name
        np.testing.assert_allclose(entry.camera.w2c, camera.w2c, atol=1e-9)
        np.testing.assert_allclose(entry.camera.intrinsics, camera.intrinsics, atol=1e-9)
        assert np.array_equal(capture.open_images(index).read(2), picture_of(index, 2))
    shutil.rmtree(tmp_path / "images")
    assert "videos/cam00.mp4: is missing, and so is images/" in refusal(tmp_path)


def test_files_that_lack_something(tmp_path: Path) -> None:
    write_easymocap(tmp_path, 2, 1)
    for name, before, after, said in (
        ("intri.yml", "K_cam01", "K_cam02", "images/cam02: is missing"),
        ("intri.yml", "rows: 3", "rows: 4", "K_cam00 has 9 numbers, not 4x3"),
        ("intri.yml", "K_", "L_", "camera cam00: has no matrix"),
        ("intri.yml", "opencv-matrix", "matrix", "has no matrix of a camera, such as K_01"),
        ("extri.yml", "T_", "U_", "camera cam00: has no translation"),
        ("extri.yml", "data: [ ", "data: [ x", "rotation is not numbers"),
    ):
        text = (tmp_path / name).read_text()
        (tmp_path / name).write_text(text.replace(before, after))
        assert said in refusal(tmp_path)
        (tmp_path / name).write_text(text)
    (tmp_path / "extri.yml").unlink()
    assert "extri.yml" in refusal(tmp_path)
