"""Captures as users record them give the correct description and pictures, or a warning."""

from __future__ import annotations

import io
from pathlib import Path

import numpy as np
import pytest
from rich.console import Console

from codec.errors import SwingsError
from tests.support.footage.checking import all_said, checked, said
from tests.support.hostile import refused
from tests.support.tiny_capture import picture_of, tiny_rig, write_dynamic3dgs, write_dynerf
from tests.support.tiny_models import transforms_of, write_model, write_pictures, write_transforms
from tests.support.trainings import train_here
from trainer.capture.capture import Picture
from trainer.capture.layout import open_capture
from trainer.errors import CaptureError
from trainer.run.check import check_capture, describe_capture
from trainer.run.config import TrainConfig
from trainer.run.prepare import prepare
from trainer.score.truth import open_held_out


def test_description_of_a_capture_and_of_one_that_has_little(tmp_path: Path) -> None:
    write_dynamic3dgs(tmp_path / "c")
    text = describe_capture(open_capture(tmp_path / "c"))
    for name, told in {
        "layout": "Dynamic 3D Gaussians", "cameras": "4, of which 3 to train on",
        "held out": "cam01", "size": "64x36 px", "frames": "3 at 30 per second: 0.1 s",
        "points": "none",
    }.items():  # fmt: skip
        assert said(text, name) == told
    assert said(text, "rig").startswith("looks at (")
    cameras, root = tiny_rig(3, arc_deg=10), tmp_path / "little"
    cameras[1] = cameras[1].resized(32, 18)
    write_model(root / "sparse", cameras, [f"{c.name}.png" for c in cameras], True)
    write_pictures(
        root, cameras, 1, True, lambda i, f: picture_of(i, f)[:: 1 + i % 2, :: 1 + i % 2]
    )
    (root / "sparse/points3D.bin").unlink()
    (root / "held_out.txt").write_text("")
    lines = checked(root)
    assert said(lines, "layout") == "COLMAP"
    assert said(lines, "held out").startswith("none: nothing to score with")
    assert said(lines, "size") == "64x36 px (2), 32x18 px (1)"
    assert said(lines, "rig").startswith("looks one way")
    assert "unknown from the rig" in "\n".join(lines)
    no_rate = "no file gives the frame rate"
    assert [line.split(":")[0] for line in all_said(lines, "warning")] == ["few cameras", no_rate]
    says = rf"{no_rate}; give --fps, or write it to fps\.txt there$"
    refused(SwingsError, says, train_here, root, tmp_path / "s")
    assert not (tmp_path / "s").exists()
    assert said(checked(root, fps=12.5), "frames").startswith("1 at 12.5 per second")


def test_a_last_frame_that_cannot_be_read_and_too_few_cameras_are_told(tmp_path: Path) -> None:
    write_dynamic3dgs(tmp_path / "c")
    (tmp_path / "c/ims/2/000002.png").write_bytes(b"none")
    refused(CaptureError, "000002", checked, tmp_path / "c")
    write_dynerf(tmp_path / "v", num_cameras=3)  # one camera is held out
    refused(CaptureError, "2 training cameras, needs 3", checked, tmp_path / "v")


def test_points_of_a_file_stand_in_for_the_captures_and_a_log_tells_what_is_waited_for(
    tmp_path: Path,
) -> None:
    write_dynerf(tmp_path / "c", num_cameras=5)
    log = io.StringIO()
    check_capture(TrainConfig(tmp_path / "c", tmp_path / "s"), Console(file=log))
    assert log.getvalue() == "reading frames of 5 cameras\n"
    points = tmp_path / "points.npz"
    np.savez(points, xyz=np.zeros((7, 3)), rgb=np.zeros((7, 3), np.uint8))
    assert said(checked(tmp_path / "c", points=points), "points") == "7"
    np.savez(points, xyz=np.zeros((0, 3)), rgb=np.zeros((0, 3), np.uint8))
    refused(CaptureError, "holds no points", checked, tmp_path / "c", points=points)


def test_a_camera_out_of_step_is_named_and_can_be_left_out(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    root, stream, cameras = tmp_path / "c", tmp_path / "s", tiny_rig(6)
    places = np.cumsum(np.random.default_rng(1).integers(0, 9, 60)) % 56

    def picture(index: int, frame: int) -> Picture:
        shown = picture_of(index, 0)
        shown[10:26, (place := places[frame + 12 - 5 * (index == 4)]) : place + 8] = 220
        return shown

    paths = write_pictures(root, cameras, 30, False, picture)
    write_transforms(root, transforms_of(cameras, [p[:1] for p in paths]) | {"fps": 30})
    late = "out of step: cam04 seems to show everything 5 frames later than the other cameras"
    assert [line for line in all_said(checked(root), "warning") if line.startswith(late)]
    assert any(doubt.startswith(late) for doubt in prepare(TrainConfig(root, stream)).find_doubts())
    left = ("cam04",)
    assert "step" not in "".join(all_said(checked(root, without_cameras=left), "warning"))
    tiny = "--num-gs", 100, "--genesis-iterations", 5, "--settle-rounds", 1, "--frames", "0:2"
    train_here(root, stream, *tiny, "--window-iterations", 2, "--without-cameras", *left)
    assert "few cameras: 4 to train on" in caplog.text
    with open_held_out(stream, root) as scored:
        names = [entry.camera.name for entry in scored.cache.capture.cameras]
    assert names == ["cam00", "cam01", "cam02", "cam03", "cam05"]
