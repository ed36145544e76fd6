"""There is a warning for a held-out camera that looks where no training camera does."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from codec.pose import rotation_about
from tests.support.footage.checking import all_said, checked
from tests.support.tiny_capture import write_dynerf
from trainer.capture.capture import Capture
from trainer.capture.layout import open_capture
from trainer.rig.coverage import coverage_doubts, describe_coverage, unseen_share, unseen_shares


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


def test_a_camera_between_the_others_is_covered(capture: Capture) -> None:
    assert coverage_doubts(unseen_shares(capture)) == []


def test_the_more_it_looks_aside_the_more_is_unseen(capture: Capture) -> None:
    shares = []
    for angle_deg in (0, 15, 30, 85):
        away = tilted(capture, angle_deg)
        shares.append(unseen_share(away, away.cameras[away.held_out[0]].camera))
    assert shares == sorted(shares)
    assert shares[0] < 0.05
    assert 0.2 < shares[2] < 0.9
    assert shares[3] > 0.99


def test_the_warning_names_the_camera_and_the_share(capture: Capture) -> None:
    away = tilted(capture, 85)
    name = away.cameras[away.held_out[0]].camera.name
    (line,) = coverage_doubts(unseen_shares(away))
    assert f"no training camera sees 100% of {name}'s picture" in line
    nobody = replace(away, cameras=tuple(replace(c, held_out=False) for c in away.cameras))
    assert coverage_doubts(unseen_shares(nobody)) == []
    assert describe_coverage(nobody, unseen_shares(nobody)) == []


def test_check_prints_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    write_dynerf(tmp_path / "c", num_cameras=9)
    away = tilted(open_capture(tmp_path / "c"), 85)
    monkeypatch.setattr("trainer.run.check.open_capture", lambda root: away)
    found = [w for w in all_said(checked(tmp_path / "c"), "warning") if w.startswith("held out")]
    assert len(found) == 1
    (line,) = all_said(checked(tmp_path / "c"), "covered")
    name = away.cameras[away.held_out[0]].camera.name
    assert line.startswith(f"0% of {name}: ")


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
