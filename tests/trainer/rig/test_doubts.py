"""Warnings about captures that may train badly."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from tests.support.footage.checking import all_said, checked
from tests.support.tiny_capture import HEIGHT_PX, WIDTH_PX, picture_of, tiny_rig, write_dynerf
from tests.support.tiny_models import transforms_of, write_pictures, write_transforms
from trainer.capture.layout import open_capture
from trainer.rig.doubts import picture_doubt, rig_doubts


def rig_of(root: Path, num_cameras: int, arc_deg: float) -> list[str]:
    cameras = tiny_rig(num_cameras, arc_deg)
    paths = write_pictures(root, cameras, 1, True, lambda *_: picture_of(0, 0))
    write_transforms(root, transforms_of(cameras, paths))
    (root / "held_out.txt").write_text("")
    return [doubt.split(":")[0] for doubt in rig_doubts(open_capture(root))]


@pytest.mark.parametrize(
    ("num_cameras", "arc_deg", "doubts"),
    [
        (16, 200, []),
        (6, 20, []),
        (5, 20, ["few cameras"]),
        (4, 70, ["few cameras"]),
        (6, 200, ["distant cameras"]),
        (4, 160, ["few cameras", "distant cameras"]),
    ],
)
def test_few_and_distant_cameras(
    tmp_path: Path, num_cameras: int, arc_deg: float, doubts: list[str]
) -> None:
    assert rig_of(tmp_path, num_cameras, arc_deg) == doubts


def test_the_camera_that_is_alone_is_named(tmp_path: Path) -> None:
    write_dynerf(tmp_path / "c", num_cameras=9)
    capture = open_capture(tmp_path / "c")
    kept = replace(capture, cameras=capture.cameras[:7] + capture.cameras[8:])
    (line,) = rig_doubts(kept)
    assert line.startswith("distant cameras: cam08 is ")


def test_pictures_that_are_clipped_or_dark() -> None:
    rng = np.random.default_rng(2)
    fine = rng.integers(0, 256, (36, 64, 3), dtype=np.uint8)
    assert picture_doubt(fine) is None
    assert picture_doubt(fine // 3) is None  # a dim room is not a fault
    for dark in (fine // np.uint8(5), fine >> np.uint8(4), np.zeros_like(fine)):
        assert str(picture_doubt(dark)).startswith("dark")
    clipped = fine.copy()
    clipped[:12] = 255
    assert str(picture_doubt(clipped)).startswith("clipped")
    mask = np.ones((36, 64), np.uint8)
    mask[:12] = 0
    assert picture_doubt(clipped, mask) is None
    assert picture_doubt(clipped, np.zeros_like(mask)) is None


def test_pictures_of_another_depth_are_named(tmp_path: Path) -> None:
    """Pictures of 12 bits stored in 16, and of 8 bits."""
    cameras = tiny_rig(9)
    write_transforms(
        tmp_path, transforms_of(cameras, write_pictures(tmp_path, cameras, 2, False)) | {"fps": 5}
    )
    rng = np.random.default_rng(4)
    for number, most in ((1, 4095), (6, 255)):
        for path in (tmp_path / f"images/cam{number:02d}").iterdir():
            grey = rng.integers(0, most + 1, (HEIGHT_PX, WIDTH_PX), dtype=np.uint16)
            Image.fromarray(grey).save(path)
    dark = [line for line in all_said(checked(tmp_path), "warning") if "dark" in line]
    assert dark == [
        "pictures of cam01, cam06 are dark: hardly a pixel is above 64 of 255, like 10 or 12 bits "
        "stored in 16"
    ]
