"""Describing and drawing a capture."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pytest
from PIL import Image

from codec.camera import Camera
from tests.support.tiny_capture import picture_of, tiny_rig, write_dynamic3dgs, write_dynerf
from tests.support.tiny_models import write_model, write_pictures
from trainer.capture.layout import open_capture
from trainer.errors import CaptureError
from trainer.run.check import check_capture, describe_capture, draw_capture, level_axes


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
    text = "\n".join(check_capture(tmp_path))
    assert "COLMAP" in text
    assert "none: nothing to score with" in text
    assert "64x36 px (2), 32x18 px (1)" in text
    assert "looks one way" in text
    assert "the rig does not tell" in text


def test_picture_shows_cameras_and_points_and_appears_whole(tmp_path: Path) -> None:
    cameras = write_dynamic3dgs(tmp_path / "c")
    rng = np.random.default_rng(3)
    xyz = rng.normal(0, 0.4, (500, 3)) - (0, 1, 0)
    xyz[0] = 1e6
    rgb = np.tile([200, 0, 200], (500, 1))
    np.savez(tmp_path / "c/init_pt_cld.npz", data=np.hstack([xyz, rgb / 255]))
    target = tmp_path / "new/picture.png"
    lines = check_capture(tmp_path / "c", target)
    assert str(target) in lines[-1]
    assert [entry.name for entry in target.parent.iterdir()] == ["picture.png"]
    with Image.open(target) as image:
        assert image.format == "PNG"
        pixels = np.array(image.convert("RGB")).astype(int)
    for colour, least in (((31, 95, 191), 300), ((217, 72, 15), 100), ((200, 0, 200), 500)):
        assert (np.abs(pixels - colour).max(axis=-1) < 12).sum() > least
    assert len(cameras) == 4
    before = target.read_bytes()
    draw_capture(open_capture(tmp_path / "c"), target)
    assert target.read_bytes() == before


def camera_at(pose: npt.NDArray[np.float64]) -> Camera:
    return Camera("cam00", 64, 36, 50.0, 50.0, 32.0, 18.0, pose)


def test_odd_rigs_are_drawn_too(tmp_path: Path) -> None:
    write_dynerf(tmp_path / "c")
    capture = open_capture(tmp_path / "c")
    flipped = np.diag([-1.0, -1.0, 1.0, 1.0])
    downward = np.array([[1.0, 0, 0, 0], [0, 0, 1, 0], [0, -1, 0, 0], [0, 0, 0, 1]])
    rigs = [
        [np.eye(4)],
        [np.eye(4), np.eye(4)],
        [np.eye(4), flipped],
        [downward, downward],
    ]
    for poses in rigs:
        cameras = tuple(replace(capture.cameras[0], camera=camera_at(p)) for p in poses)
        axes = level_axes([c.camera for c in cameras])
        assert np.allclose(axes @ axes.T, np.eye(3))
        assert np.linalg.det(axes) == pytest.approx(1)
        draw_capture(replace(capture, cameras=cameras), tmp_path / "odd.png")


def test_up_is_where_the_pictures_tops_are() -> None:
    axes = level_axes(tiny_rig(9))
    assert np.dot(axes[2], (0, -1, 0)) > 0.99


def test_a_last_frame_that_cannot_be_read_is_found(tmp_path: Path) -> None:
    write_dynamic3dgs(tmp_path / "c")
    (tmp_path / "c/ims/2/000002.png").write_bytes(b"none")
    with pytest.raises(CaptureError, match="000002"):
        check_capture(tmp_path / "c")


def test_too_few_cameras_to_train_on_are_told(tmp_path: Path) -> None:
    write_dynerf(tmp_path / "c", num_cameras=3)  # one of them is held out
    with pytest.raises(CaptureError, match="2 training cameras, needs 3"):
        check_capture(tmp_path / "c")


def test_points_of_a_file_stand_in_for_the_captures(tmp_path: Path) -> None:
    write_dynerf(tmp_path / "c", num_cameras=5)
    points = tmp_path / "points.npz"
    np.savez(points, xyz=np.zeros((7, 3)), rgb=np.zeros((7, 3), np.uint8))
    lines = check_capture(tmp_path / "c", points=points)
    assert [line.split() for line in lines if line.startswith("points")] == [["points", "7"]]
    np.savez(points, xyz=np.zeros((0, 3)), rgb=np.zeros((0, 3), np.uint8))
    with pytest.raises(CaptureError, match="holds no points"):
        check_capture(tmp_path / "c", points=points)
