"""Describing and drawing a capture."""

from __future__ import annotations

import io
from pathlib import Path

import numpy as np
import pytest
from rich.console import Console

from codec.errors import InvalidError
from tests.support.footage.checking import checked
from tests.support.tiny_capture import picture_of, tiny_rig, write_dynamic3dgs, write_dynerf
from tests.support.tiny_models import write_model, write_pictures
from trainer.capture.layout import open_capture
from trainer.errors import CaptureError
from trainer.run.check import check_capture, describe_capture
from trainer.run.config import TrainConfig


def test_description(tmp_path: Path) -> None:
    write_dynamic3dgs(tmp_path / "c")
    text = describe_capture(open_capture(tmp_path / "c"))
    words = {line.split()[0]: line.split(maxsplit=1)[1] for line in text}
    assert words["layout"] == "Dynamic 3D Gaussians"
    assert words["cameras"] == "4, of which 3 to train on"
    assert words["held"] == "out    cam01"
    assert words["size"] == "64x36 px"
    assert words["frames"] == "3 at 30 per second: 0.1 s"
    assert words["points"] == "none"
    assert words["rig"].startswith("looks at (")
    assert all("\n" not in line for line in text)


def test_description_of_a_rig_that_tells_little(tmp_path: Path) -> None:
    cameras = tiny_rig(3, arc_deg=10)
    cameras[1] = cameras[1].resized(32, 18)
    write_model(tmp_path / "sparse", cameras, [f"{c.name}.png" for c in cameras], True)
    write_pictures(
        tmp_path, cameras, 1, True, lambda i, f: picture_of(i, f)[:: 1 + i % 2, :: 1 + i % 2]
    )
    (tmp_path / "sparse/points3D.bin").unlink()
    (tmp_path / "held_out.txt").write_text("")
    text = "\n".join(checked(tmp_path))
    assert "COLMAP" in text
    assert "none: nothing to score with" in text
    assert "64x36 px (2), 32x18 px (1)" in text
    assert "looks one way" in text
    assert "unknown from the rig" in text


def test_a_last_frame_that_cannot_be_read_is_found(tmp_path: Path) -> None:
    write_dynamic3dgs(tmp_path / "c")
    (tmp_path / "c/ims/2/000002.png").write_bytes(b"none")
    with pytest.raises(CaptureError, match="000002"):
        checked(tmp_path / "c")


def test_too_few_cameras_to_train_on_are_told(tmp_path: Path) -> None:
    write_dynerf(tmp_path / "c", num_cameras=3)  # one camera is held out
    with pytest.raises(CaptureError, match="2 training cameras, needs 3"):
        checked(tmp_path / "c")


def test_points_of_a_file_stand_in_for_the_captures(tmp_path: Path) -> None:
    write_dynerf(tmp_path / "c", num_cameras=5)
    points = tmp_path / "points.npz"
    np.savez(points, xyz=np.zeros((7, 3)), rgb=np.zeros((7, 3), np.uint8))
    lines = checked(tmp_path / "c", points=points)
    assert [line.split() for line in lines if line.startswith("points")] == [["points", "7"]]
    np.savez(points, xyz=np.zeros((0, 3)), rgb=np.zeros((0, 3), np.uint8))
    with pytest.raises(CaptureError, match="holds no points"):
        checked(tmp_path / "c", points=points)


def test_a_scale_that_cannot_be_is_refused_before_the_capture_is_read(tmp_path: Path) -> None:
    for scale in (2.0, 0.0, float("nan")):
        with pytest.raises(InvalidError, match=r"choose above 0, at most 1"):
            checked(tmp_path / "there is none", scale=scale)


def test_a_log_tells_what_is_waited_for(tmp_path: Path) -> None:
    write_dynerf(tmp_path / "c", num_cameras=7)
    log = io.StringIO()
    check_capture(TrainConfig(tmp_path / "c", tmp_path / "s"), Console(file=log))
    assert log.getvalue() == "reading the first and the last frame of 7 cameras\n"
