"""The near plane of a rig, or of one camera; and warnings about captures."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from codec.camera import Camera, rotation_about
from codec.rig import rig_depths
from tests.support.footage.checking import all_said, checked, said
from tests.support.footage.rebuilt import SIZE_PX, close_rig, points_seen, studios
from tests.support.tiny_capture import HEIGHT_PX, WIDTH_PX, tiny_rig, write_dynerf
from tests.support.tiny_models import transforms_of, write_pictures, write_transforms
from trainer.calibrate.lateness import late_frames
from trainer.capture.capture import Capture
from trainer.capture.layout import open_capture, twin_doubts
from trainer.rig import nearplane
from trainer.rig.doubts import (
    coverage_doubts,
    describe_coverage,
    picture_doubt,
    rig_doubts,
    unseen_share,
    unseen_shares,
)
from trainer.rig.nearplane import LEAST_OWN_SHARE, LEAST_SHARE, MARGIN, look
from trainer.run.config import TrainConfig
from trainer.run.prepare import prepare
from trainer.synth.scene import camera_rig


def write(root: Path, cameras: list[Camera], points: int) -> Capture:
    """Writes one frame in the nerfstudio layout, with all cameras for training."""
    seen = studios(cameras)
    paths = write_pictures(root, cameras, 1, False, lambda i, _: seen[i].film(0)[0])
    write_transforms(root, transforms_of(cameras, paths) | {"fps": 30})
    (root / "held_out.txt").write_text("")
    if points:
        xyz, rgb = points_seen(seen, points)
        np.savez(root / "points.npz", xyz=xyz, rgb=rgb)
    return open_capture(root)


def least_depths(cameras: list[Camera]) -> list[float]:
    """Minimum depth of everything that each camera sees."""
    return [float(studio.depth(0).min()) for studio in studios(cameras)]


def planes_of(capture: Capture) -> tuple[float, dict[str, float]]:
    """The near plane, and those by camera."""
    seen = look(capture, range(1))
    near = nearplane.near_plane(capture, seen)
    assert near is not None
    planes = nearplane.near_planes(capture, seen)
    return near, dict(zip([c.camera.name for c in capture.cameras], planes, strict=True))


def near_of(capture: Capture) -> float:
    return planes_of(capture)[0]


RING = camera_rig(12, *SIZE_PX, float(np.radians(200)))


@pytest.fixture(scope="module")
def ring(tmp_path_factory: pytest.TempPathFactory) -> Capture:
    return write(tmp_path_factory.mktemp("ring"), RING, 3000)


@pytest.fixture(scope="module")
def close(tmp_path_factory: pytest.TempPathFactory) -> Capture:
    return write(tmp_path_factory.mktemp("close"), close_rig(), 6000)


def test_a_rig_that_sees_nothing_near_keeps_what_the_rig_suggests(ring: Capture) -> None:
    depths = rig_depths(RING)
    assert depths is not None
    for capture in (ring, replace(ring, points=None)):
        near, planes = planes_of(capture)
        assert near == capture.near_m == pytest.approx(depths[0])
        assert set(planes.values()) == {capture.near_m}
    lines = checked(ring.root)
    assert said(lines, "near").endswith(", from the rig")
    assert not all_said(lines, "near of")


def test_points_that_a_camera_sees_bring_it_in(close: Capture) -> None:
    capture, cameras = close, [entry.camera for entry in close.cameras]
    depths = least_depths(cameras)
    nearest = min(depths)
    suggested = capture.near_m
    assert suggested is not None
    assert nearest < 0.6 * suggested
    near, planes = planes_of(capture)
    assert near == pytest.approx(LEAST_SHARE * suggested)  # but not nearer automatically
    lines = checked(close.root)
    assert said(lines, "near").startswith(f"{near:.3g} units, from what the cameras see; the rig ")
    assert said(lines, "near cuts").startswith("at most 0.5%")  # cameras have their own planes
    for camera, depth in zip(cameras, depths, strict=True):
        own = max(MARGIN * depth, LEAST_OWN_SHARE * suggested)
        assert planes[camera.name] == pytest.approx(min(own, near), rel=0.1)
        assert planes[camera.name] <= near
    assert f"cam10 {planes['cam10']:.3g}" in said(lines, "near of")
    assert said(checked(close.root, near_m=0.8 * nearest), "near cuts").startswith("at most 0.5%")
    lines = checked(close.root, near_m=suggested)
    assert said(lines, "near").endswith("units, as given")
    cut = [line for line in all_said(lines, "warning") if "near plane" in line]
    assert len(cut) == 3
    assert all("--near-m" in line for line in cut)
    assert any(line.startswith("the near plane of cam10, ") for line in cut)


def test_without_points_so_do_cameras_that_agree_in_a_world_of_any_unit(tmp_path: Path) -> None:
    cameras = close_rig(16)
    capture = write(tmp_path, cameras, 0)
    assert capture.near_m is not None
    near = near_of(capture)
    assert near < 0.9 * capture.near_m
    for camera in cameras:
        camera.w2c[:3, 3] *= 40
    paths = [[f"images/{camera.name}/0007.png"] for camera in cameras]
    write_transforms(tmp_path, transforms_of(cameras, paths))
    assert near_of(open_capture(tmp_path)) / 40 == pytest.approx(near, rel=1e-3)


def with_points(capture: Capture, count: int, depth_m: float) -> Capture:
    """The capture whose first `count` points are at that depth in the middle of cam06."""
    assert capture.points is not None
    xyz, camera = capture.points.xyz.copy(), capture.cameras[6].camera
    xyz[:count] = camera.position + depth_m * camera.forward
    return replace(capture, points=replace(capture.points, xyz=xyz))


def test_stray_points_do_not(ring: Capture) -> None:
    assert near_of(with_points(ring, 5, 0.8)) == ring.near_m
    there = with_points(with_points(ring, 60, 0.9), 5, 0.8)
    assert near_of(there) == pytest.approx(MARGIN * 0.9)
    assert planes_of(there)[1]["cam06"] == pytest.approx(MARGIN * 0.9)
    seen = look(there, range(1))
    assert seen is not None
    assert nearplane.cut_by(there, seen, 0.91)[0][0] == "cam06"


def test_what_is_too_near_is_cut_and_named(ring: Capture) -> None:
    """A camera's own plane has a bound, also for a held-out camera."""
    cameras = tuple(replace(c, held_out=i == 6) for i, c in enumerate(ring.cameras))
    capture, suggested = replace(ring, cameras=cameras), ring.near_m
    assert suggested is not None
    for depth, own in ((0.5, MARGIN * 0.5), (0.1, LEAST_OWN_SHARE)):
        near_by = with_points(capture, 60, depth * suggested)
        seen = look(near_by, range(1))
        planes = nearplane.near_planes(near_by, seen)
        assert planes[6] == pytest.approx(own * suggested, rel=0.01)
        doubts = nearplane.near_doubts(near_by, seen, planes)
        assert ["cam06, " in doubt for doubt in doubts[:1]] == [True] * (depth <= LEAST_OWN_SHARE)


def test_pictures_without_texture_do_not(tmp_path: Path) -> None:
    """Every depth matches such pictures."""
    cameras = tiny_rig(9)
    flat = np.full((36, 64, 3), 90, np.uint8)
    paths = write_pictures(tmp_path, cameras, 1, False, lambda *_: flat)
    write_transforms(tmp_path, transforms_of(cameras, paths))
    capture = open_capture(tmp_path)
    assert near_of(capture) == capture.near_m


def test_a_rig_that_looks_one_way_keeps_what_it_declares(tmp_path: Path) -> None:
    cameras = camera_rig(6, *SIZE_PX, float(np.radians(20)))
    capture = write(tmp_path / "with", cameras, 1000)
    seen = look(capture, range(1))
    assert seen is None
    assert nearplane.near_plane(capture, seen) == capture.near_m
    assert nearplane.near_planes(capture, seen) == ()
    capture = write(tmp_path / "without", cameras, 0)
    assert nearplane.near_plane(capture, look(capture, range(1))) is None
    assert said(checked(tmp_path / "without"), "near").startswith("0.2 units, by default")


def test_new_places_are_searched_from_where_the_rig_says(close: Capture, tmp_path: Path) -> None:
    found = prepare(TrainConfig(close.root, tmp_path / "s"))
    assert not found.near_doubts
    assert close.near_m is not None
    assert found.near_m < 0.9 * close.near_m
    assert found.search_from_m == close.near_m
    assert found.camera_near_m == tuple(planes_of(close)[1].values())
    assert found.training_planes == list(found.camera_near_m)
    given = prepare(TrainConfig(close.root, tmp_path / "s", near_m=0.3))
    assert given.near_m == given.search_from_m == 0.3
    assert set(given.training_planes) == {0.3}


def test_few_and_distant_cameras_are_named(capture: Capture) -> None:
    few, distant = "few cameras", "distant cameras"
    for num_cameras, arc_deg, doubts in (
        (16, 200, []), (6, 20, []), (5, 20, [few]), (4, 70, [few]), (6, 200, [distant]),
        (4, 160, [few, distant]),
    ):  # fmt: skip
        entry = replace(capture.cameras[0], held_out=False)
        cameras = tuple(replace(entry, camera=c) for c in tiny_rig(num_cameras, arc_deg))
        found = rig_doubts(replace(capture, cameras=cameras))
        assert [doubt.split(":")[0] for doubt in found] == doubts
    kept = replace(capture, cameras=capture.cameras[:7] + capture.cameras[8:])
    (line,) = rig_doubts(kept)
    assert line.startswith("distant cameras: cam08 is ")
    rig = [entry.camera for entry in capture.cameras]
    assert not twin_doubts(rig)
    (line,) = twin_doubts([*rig, replace(rig[0], name="twin")])
    assert line.startswith("one pose: cam00 and twin have the same one")


def test_by_how_many_frames_a_camera_is_late() -> None:
    rng = np.random.default_rng(3)
    motion = np.exp(rng.normal(size=100))
    for late in ([0] * 6, [0, 0, 5, 0, 0, 0], [0, -3, 0, 0, 0, 12]):
        gains, noise = rng.uniform(0.3, 3, 6), rng.uniform(0.9, 1.1, (6, 59))
        changes = np.array([motion[20 - frames : 79 - frames] for frames in late])
        assert late_frames(gains[:, None] * changes * noise) == late
    for nothing in (rng.uniform(0, 3, (6, 59)), np.zeros((6, 59)), changes[:, :20], changes[:3]):
        assert late_frames(nothing) == [0] * len(nothing)


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


def test_dark_pictures_of_more_bits_are_named(tmp_path: Path) -> None:
    cameras, rng = tiny_rig(9), np.random.default_rng(4)
    paths = write_pictures(tmp_path, cameras, 2, False)
    write_transforms(tmp_path, transforms_of(cameras, paths) | {"fps": 5})
    for number, most in ((1, 4095), (6, 255)):  # 12 bits stored in 16, and 8
        for path in (tmp_path / f"images/cam{number:02d}").iterdir():
            grey = rng.integers(0, most + 1, (HEIGHT_PX, WIDTH_PX), dtype=np.uint16)
            Image.fromarray(grey).save(path)
    (dark,) = (line for line in all_said(checked(tmp_path), "warning") if "dark" in line)
    assert dark.startswith("pictures of cam01, cam06 are dark: hardly a pixel is above 64 of 255")


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


def test_each_held_out_camera_is_listed_the_least_covered_first_with_a_warning(
    capture: Capture, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (index,) = capture.held_out
    away = tilted(capture, 85)
    cameras = tuple(replace(c, held_out=i in (1, index)) for i, c in enumerate(away.cameras))
    both, name = replace(away, cameras=cameras), cameras[index].camera.name
    (doubt,) = coverage_doubts(unseen_shares(both))
    assert f"no training camera sees 100% of {name}'s picture" in doubt
    monkeypatch.setattr("trainer.run.check.open_capture", lambda *_: both)
    lines = checked(tmp_path / "c")
    assert doubt in all_said(lines, "warning")
    least, other, *_ = said(lines, "covered").split(", ")
    assert least == f"0% of {name}"
    assert int(other.split("%")[0]) > 50
    assert f"% of {cameras[1].camera.name}" in other
    nobody = replace(away, cameras=tuple(replace(c, held_out=False) for c in away.cameras))
    assert coverage_doubts(unseen_shares(nobody)) == []
    assert describe_coverage(nobody, unseen_shares(nobody)) == []
    many = {f"cam{i:02d}": 0.5 - i / 100 for i in range(12)}
    assert "at least 58% of 4 more" in describe_coverage(capture, many)[0]
