"""Warnings about captures that may train badly, or that no score can judge."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from codec.pose import rotation_about
from tests.support.footage.checking import all_said, checked, said
from tests.support.tiny_capture import HEIGHT_PX, WIDTH_PX, picture_of, tiny_rig, write_dynerf
from tests.support.tiny_models import transforms_of, write_pictures, write_transforms
from trainer.capture.capture import Capture
from trainer.capture.layout import open_capture
from trainer.rig.coverage import coverage_doubts, describe_coverage, unseen_share, unseen_shares
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


def test_the_camera_that_is_alone_is_named(capture: Capture) -> None:
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


@pytest.fixture
def capture(tmp_path: Path) -> Capture:
    write_dynerf(tmp_path / "c", num_cameras=9)
    return open_capture(tmp_path / "c")


def tilted(capture: Capture, angle_deg: float) -> Capture:
    """The capture with its held-out camera tilted up by `angle_deg`."""
    (index,) = capture.held_out
    turn = np.eye(4)
    turn[:3, :3] = rotation_about(np.array([1.0, 0.0, 0.0]), np.radians(-angle_deg))
    cameras = list(capture.cameras)
    camera = cameras[index].camera
    cameras[index] = replace(cameras[index], camera=replace(camera, w2c=turn @ camera.w2c))
    return replace(capture, cameras=tuple(cameras))


def test_the_more_a_held_out_camera_looks_aside_the_more_is_unseen(capture: Capture) -> None:
    assert coverage_doubts(unseen_shares(capture)) == []
    shares = []
    for angle_deg in (0, 15, 30, 85):
        away = tilted(capture, angle_deg)
        shares.append(unseen_share(away, away.cameras[away.held_out[0]].camera))
    assert shares == sorted(shares)
    assert shares[0] < 0.05
    assert 0.2 < shares[2] < 0.9
    assert shares[3] > 0.99


def test_the_warning_names_the_camera_and_the_share(
    capture: Capture, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    away = tilted(capture, 85)
    name = away.cameras[away.held_out[0]].camera.name
    (doubt,) = coverage_doubts(unseen_shares(away))
    assert f"no training camera sees 100% of {name}'s picture" in doubt
    monkeypatch.setattr("trainer.run.check.open_capture", lambda root: away)
    lines = checked(tmp_path / "c")
    assert doubt in all_said(lines, "warning")
    assert said(lines, "covered").startswith(f"0% of {name}: ")
    nobody = replace(away, cameras=tuple(replace(c, held_out=False) for c in away.cameras))
    assert coverage_doubts(unseen_shares(nobody)) == []
    assert describe_coverage(nobody, unseen_shares(nobody)) == []


def test_each_held_out_camera_is_listed_the_least_covered_first(capture: Capture) -> None:
    (index,) = capture.held_out
    away = tilted(capture, 30)
    cameras = tuple(replace(c, held_out=i in (1, index)) for i, c in enumerate(away.cameras))
    both = replace(away, cameras=cameras)
    shares = unseen_shares(both)
    assert set(shares) == {cameras[1].camera.name, cameras[index].camera.name}
    (line,) = describe_coverage(both, shares)
    percents = [int(part.split("%")[0].split()[-1]) for part in line.split(",")]
    assert percents == sorted(percents)
    worst = cameras[index].camera
    assert percents[0] == int(100 - 100 * unseen_share(both, worst))
    assert f"{percents[0]}% of {worst.name}, " in line
    many = {f"cam{i:02d}": 0.5 - i / 100 for i in range(12)}
    assert "at least 58% of 4 more" in describe_coverage(capture, many)[0]
