"""Captures as users record them give the correct pictures, or the correct warning."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from codec.stream import StreamReader
from tests.support.commands import run, run_ok
from tests.support.footage.checking import all_said, checked, said
from tests.support.footage.rebuilt import (
    NUM_FRAMES,
    Footage,
    write_distant,
    write_portrait,
    write_radial,
)
from trainer.capture.capture import Capture, Picture
from trainer.capture.layout import open_capture
from trainer.rig.nearplane import look, near_plane

TINY = (
    "--num-gs", "1500", "--genesis-iterations", "250", "--settle-rounds", "1",
    "--window-iterations", "25", "--segment-frames", "3", "--snapshot-every", "0",
)  # fmt: skip


def check_pictures(capture: Capture, footage: Footage, least_db: float) -> None:
    """Asserts that the cameras are the filming ones, and the pictures those of pinholes."""
    assert capture.num_frames == NUM_FRAMES
    for index, (camera, pictures) in enumerate(zip(footage.cameras, footage.pictures, strict=True)):
        read = capture.cameras[index].camera
        assert read.name == camera.name
        np.testing.assert_allclose(read.w2c, camera.w2c, atol=1e-9)
        np.testing.assert_allclose(read.intrinsics, camera.intrinsics, atol=1e-9)
        source = capture.open_images(index)
        for frame in (NUM_FRAMES - 1, 0):
            shown, truth = source.read(frame), pictures[frame]
            here = likeness_db(shown, truth)
            beside = [likeness_db(np.roll(shown, by, axis), truth) for by in (-1, 1)
                      for axis in (0, 1)]  # fmt: skip
            assert here > least_db
            assert here > max(beside) + 1
        source.close()


def likeness_db(shown: Picture, truth: Picture) -> float:
    """PSNR of the pictures' 4x4 means, because distortion and its removal soften a picture. The
    edge, where a lens may see less than a pinhole, is left out."""
    a, b = (
        np.asarray(Image.fromarray(p[4:-4, 4:-4]).reduce(4), np.float64) for p in (shown, truth)
    )
    return float(-10 * np.log10(np.square((a - b) / 255).mean()))


def trained(capture: Path, stream: Path, *options: str) -> dict[str, float]:
    """PSNR of each held-out camera."""
    run_ok("swings-train", capture, stream, *TINY, *options)
    scores = json.loads(run_ok("swings-eval", stream, capture, "--json"))["layers"][-1]
    per_camera: dict[str, float] = scores["per_camera_psnr_db"]
    return per_camera


def test_videos_of_cameras_with_lenses_of_their_own_one_of_them_upright(tmp_path: Path) -> None:
    root = tmp_path / "c"
    footage = write_portrait(root)
    (root / "held_out.txt").write_text("cam05 cam09")
    check_pictures(open_capture(root), footage, 45)
    lines = checked(root)
    assert said(lines, "size") == "128x72 px (15), 72x128 px (1)"
    assert said(lines, "frames") == "3 at 25 per second: 0.1 s"
    assert not all_said(lines, "warning")
    scores = trained(root, tmp_path / "s")
    assert list(scores) == ["cam05", "cam09"]  # the portrait one is cam05
    assert min(scores.values()) > 17


@pytest.mark.slow
def test_a_radial_lens_in_a_world_of_any_unit(tmp_path: Path) -> None:
    root = tmp_path / "c"
    footage = write_radial(root)
    capture = open_capture(root)
    check_pictures(capture, footage, 31)
    assert [capture.cameras[i].camera.name for i in capture.held_out] == ["cam08"]
    lines = checked(root)
    assert said(lines, "size") == "128x72 px (17), 96x54 px (1)"
    assert " m" not in said(lines, "near") + said(lines, "far") + said(lines, "rig")
    assert said(lines, "near").split()[1] == "units,"
    assert [line.split(":")[0] for line in all_said(lines, "warning")] == [
        "no file gives the frame rate"
    ]
    done = run("swings-train", root, tmp_path / "s")
    assert (done.returncode, done.stdout) == (1, "")
    (line,) = done.stderr.splitlines()
    assert line.endswith("no file gives the frame rate; give --fps, or write it to fps.txt there")
    assert not (tmp_path / "s").exists()
    scores = trained(root, tmp_path / "s", "--fps", "12.5")
    assert StreamReader(tmp_path / "s").manifest.fps == 12.5
    assert min(scores.values()) > 17


@pytest.mark.slow
def test_the_unit_of_the_world_does_not_matter(tmp_path: Path) -> None:
    found = []
    for scale in (1.0, 40.0):
        root = tmp_path / str(scale)
        write_radial(root, scale, 8)
        capture = open_capture(root)
        near = near_plane(capture, look(capture, range(1)))
        assert near is not None
        found.append((near / scale, capture.held_out))
    (near, held_out), (far_near, far_held_out) = found
    assert near == pytest.approx(far_near, rel=1e-3)
    assert held_out == far_held_out


def test_four_distant_cameras_are_read_rightly_and_warned_of(tmp_path: Path) -> None:
    root = tmp_path / "c"
    footage = write_distant(root)
    check_pictures(open_capture(root), footage, 31)
    few, distant, *more = all_said(checked(root), "warning")
    assert few.startswith("few cameras: 3 to train on")
    assert distant.startswith("distant cameras: cam")
    assert len(more) <= 1
    done = run("swings-train", root, tmp_path / "s", *TINY)
    assert done.returncode == 0, done.stderr
    assert f"WARNING trainer.run.job: {few}" in done.stderr
