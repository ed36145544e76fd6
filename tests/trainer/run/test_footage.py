"""Captures as users record them give the correct pictures, or the correct warning."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from codec.errors import SwingsError
from codec.stream import StreamReader
from tests.support.footage.checking import all_said, checked, said
from tests.support.footage.rebuilt import Footage, write_distant, write_portrait, write_radial
from tests.support.trainings import train_here
from trainer.capture.capture import Capture, Picture
from trainer.capture.layout import open_capture
from trainer.score.evaluate import EvaluateConfig, evaluate_stream


def check_pictures(capture: Capture, footage: Footage, least_db: float) -> None:
    """Asserts that the cameras are the filming ones, and the pictures those of pinholes."""
    assert capture.num_frames == len(footage.pictures[0])
    for index, (camera, pictures) in enumerate(zip(footage.cameras, footage.pictures, strict=True)):
        read = capture.cameras[index].camera
        assert read.name == camera.name
        np.testing.assert_allclose(read.w2c, camera.w2c, atol=1e-9)
        np.testing.assert_allclose(read.intrinsics, camera.intrinsics, atol=1e-9)
        source = capture.open_images(index)
        for frame in (len(pictures) - 1, 0):
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


def test_videos_of_cameras_with_lenses_of_their_own_one_of_them_upright(tmp_path: Path) -> None:
    footage = write_portrait(tmp_path)
    check_pictures(open_capture(tmp_path), footage, 45)
    lines = checked(tmp_path)
    assert said(lines, "size") == "128x72 px (9), 72x128 px (1)"
    assert said(lines, "frames") == "2 at 25 per second: 0.1 s"
    assert not all_said(lines, "warning")


def test_a_radial_lens_in_a_world_of_any_unit(tmp_path: Path) -> None:
    root = tmp_path / "c"
    footage = write_radial(root)
    capture = open_capture(root)
    check_pictures(capture, footage, 31)
    assert [capture.cameras[i].camera.name for i in capture.held_out] == ["cam04"]
    lines = checked(root)
    assert said(lines, "size") == "128x72 px (8), 96x54 px (1)"
    assert " m" not in said(lines, "near") + said(lines, "far") + said(lines, "rig")
    assert said(lines, "near").split()[1] == "units,"
    assert [line.split(":")[0] for line in all_said(lines, "warning")] == [
        "no file gives the frame rate"
    ]
    with pytest.raises(
        SwingsError,
        match=r"no file gives the frame rate; give --fps, or write it to fps\.txt there$",
    ):
        train_here(root, tmp_path / "s")
    assert not (tmp_path / "s").exists()


def test_four_distant_cameras_are_read_rightly_and_warned_of(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    root = tmp_path / "c"
    footage = write_distant(root)
    check_pictures(open_capture(root), footage, 31)
    few, distant, *more = all_said(checked(root), "warning")
    assert few.startswith("few cameras: 3 to train on")
    assert distant.startswith("distant cameras: cam")
    assert len(more) <= 1
    tiny = "--num-gs", 100, "--genesis-iterations", 5, "--settle-rounds", 1
    train_here(root, tmp_path / "s", *tiny, "--window-iterations", 2)
    assert few in caplog.text


@pytest.mark.deep
@pytest.mark.parametrize(
    ("write", "held_out", "more"),
    [
        (write_portrait, ["cam05", "cam08"], ()),  # the portrait one is cam05
        (write_radial, ["cam04"], ("--fps", 12.5)),
    ],
)
def test_such_captures_are_trained_like_others(
    write: Callable[[Path], Footage], held_out: list[str], more: tuple[object, ...], tmp_path: Path
) -> None:
    root, stream = tmp_path / "c", tmp_path / "s"
    write(root)
    (root / "held_out.txt").write_text(" ".join(held_out))
    train_here(
        root, stream, "--num-gs", 1500, "--genesis-iterations", 250, "--settle-rounds", 1,
        "--window-iterations", 25, "--snapshot-every", 0, *more,
    )  # fmt: skip
    assert StreamReader(stream).manifest.fps == (more[1] if more else 25)
    scores = evaluate_stream(EvaluateConfig(stream, root)).layers[-1].per_camera_psnr_db
    assert list(scores) == held_out
    assert min(scores.values()) > 17
