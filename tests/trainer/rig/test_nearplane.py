"""The near plane is that of the rig, or nearer for a camera that sees something nearer."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from codec.camera import Camera
from codec.rig import rig_depths
from tests.support.footage.checking import all_said, checked, said
from tests.support.footage.rebuilt import HEIGHT_PX, WIDTH_PX, close_rig, points_seen, room
from tests.support.tiny_capture import tiny_rig
from tests.support.tiny_models import transforms_of, write_pictures, write_transforms
from trainer.capture.capture import Capture
from trainer.capture.layout import open_capture
from trainer.rig import nearplane
from trainer.rig.nearplane import LEAST_OWN_SHARE, LEAST_SHARE, MARGIN, look
from trainer.run.config import TrainConfig
from trainer.run.prepare import prepare
from trainer.synth.film import Studio
from trainer.synth.scene import camera_rig


def write(root: Path, cameras: list[Camera], points: int) -> Capture:
    """Writes one frame in the nerfstudio layout, with all cameras for training."""
    for camera in cameras:
        (root / "images" / camera.name).mkdir(parents=True)
        picture, _ = Studio(room(), camera).film(0)
        Image.fromarray(picture).save(root / f"images/{camera.name}/0000.png")
    declare(root, cameras)
    (root / "held_out.txt").write_text("")
    if points:
        xyz, rgb = points_seen(cameras, points)
        np.savez(root / "points.npz", xyz=xyz, rgb=rgb)
    return open_capture(root)


def declare(root: Path, cameras: list[Camera]) -> None:
    paths = [[f"images/{camera.name}/0000.png"] for camera in cameras]
    write_transforms(root, transforms_of(cameras, paths) | {"fps": 30})


def least_depth(camera: Camera) -> float:
    """Minimum depth of everything that the camera sees."""
    studio = Studio(room(), camera)
    return studio.depth_range(studio.film(0)[1])[0]


def near_of(capture: Capture) -> float:
    near = nearplane.near_plane(capture, look(capture, range(1)))
    assert near is not None
    return near


def planes_of(capture: Capture) -> dict[str, float]:
    """The near planes by camera."""
    planes = nearplane.near_planes(capture, look(capture, range(1)))
    return dict(zip([c.camera.name for c in capture.cameras], planes, strict=True))


def test_a_rig_that_sees_nothing_near_keeps_what_the_rig_suggests(tmp_path: Path) -> None:
    cameras = camera_rig(12, WIDTH_PX, HEIGHT_PX, float(np.radians(200)))
    depths = rig_depths(cameras)
    assert depths is not None
    for name, points in (("with", 2000), ("without", 0)):
        capture = write(tmp_path / name, cameras, points)
        assert near_of(capture) == capture.near_m == pytest.approx(depths[0])
        assert set(planes_of(capture).values()) == {capture.near_m}
    lines = checked(tmp_path / "with")
    assert said(lines, "near").endswith(", from the rig")
    assert not all_said(lines, "near of")
    assert said(lines, "near cuts").startswith("at most 0.5%")


def test_points_that_a_camera_sees_bring_it_in(tmp_path: Path) -> None:
    cameras = close_rig()
    capture = write(tmp_path, cameras, 6000)
    nearest = min(map(least_depth, cameras))
    suggested = capture.near_m
    assert suggested is not None
    assert nearest < 0.6 * suggested
    near = near_of(capture)
    assert near == pytest.approx(LEAST_SHARE * suggested)  # but not nearer automatically
    lines = checked(tmp_path)
    told = f"{near:.3g} units, from what the cameras see; the rig alone would give {suggested:.3g}"
    assert said(lines, "near") == told
    assert said(lines, "near cuts").startswith("at most 0.5%")  # cameras have their own planes
    planes = planes_of(capture)
    for camera in cameras:
        own = max(MARGIN * least_depth(camera), LEAST_OWN_SHARE * suggested)
        assert planes[camera.name] == pytest.approx(min(own, near), rel=0.1)
        assert planes[camera.name] <= near
    assert f"cam10 {planes['cam10']:.3g}" in said(lines, "near of")
    assert said(checked(tmp_path, near_m=0.8 * nearest), "near cuts").startswith("at most 0.5%")
    lines = checked(tmp_path, near_m=suggested)
    assert said(lines, "near").endswith("units, as given")
    cut = [line for line in all_said(lines, "warning") if "near plane" in line]
    assert len(cut) == 3
    assert all("--near-m" in line for line in cut)
    assert any(line.startswith("the near plane of cam10, ") for line in cut)


def test_so_do_cameras_that_agree_where_there_are_no_points_in_a_world_of_any_unit(
    tmp_path: Path,
) -> None:
    cameras = close_rig(16)
    capture = write(tmp_path, cameras, 0)
    assert capture.near_m is not None
    near = near_of(capture)
    assert near < 0.9 * capture.near_m
    for camera in cameras:
        camera.w2c[:3, 3] *= 40
    declare(tmp_path, cameras)
    assert near_of(open_capture(tmp_path)) / 40 == pytest.approx(near, rel=1e-3)


def test_stray_points_do_not(tmp_path: Path) -> None:
    cameras = camera_rig(12, WIDTH_PX, HEIGHT_PX, float(np.radians(200)))
    capture = write(tmp_path, cameras, 3000)
    points = capture.points
    assert points is not None
    xyz = points.xyz.copy()
    for i in range(5):
        xyz[i] = cameras[6].position + 0.8 * cameras[6].forward
    strayed = replace(capture, points=replace(points, xyz=xyz))
    assert near_of(strayed) == capture.near_m
    for i in range(5, 60):
        xyz[i] = cameras[6].position + 0.9 * cameras[6].forward
    there = replace(capture, points=replace(points, xyz=xyz))
    assert near_of(there) == pytest.approx(MARGIN * 0.9)
    assert planes_of(there)["cam06"] == pytest.approx(MARGIN * 0.9)
    seen = look(there, range(1))
    assert seen is not None
    assert nearplane.cut_by(there, seen, 0.91)[0][0] == "cam06"


def test_what_is_too_near_is_cut_and_named(tmp_path: Path) -> None:
    """A camera's own plane has a bound, also for a held-out camera."""
    cameras = camera_rig(12, WIDTH_PX, HEIGHT_PX, float(np.radians(200)))
    write(tmp_path, cameras, 3000)
    (tmp_path / "held_out.txt").write_text("cam06\n")
    capture = open_capture(tmp_path)
    points, suggested = capture.points, capture.near_m
    assert points is not None
    assert suggested is not None
    for depth, own in ((0.5, MARGIN * 0.5), (0.1, LEAST_OWN_SHARE)):
        xyz = points.xyz.copy()
        xyz[:60] = cameras[6].position + depth * suggested * cameras[6].forward
        near_by = replace(capture, points=replace(points, xyz=xyz))
        seen = look(near_by, range(1))
        planes = nearplane.near_planes(near_by, seen)
        assert planes[6] == pytest.approx(own * suggested, rel=0.01)
        doubts = nearplane.near_doubts(near_by, seen, planes)
        if depth > LEAST_OWN_SHARE:
            assert not doubts
        else:
            assert doubts[0].startswith("the near plane of cam06, ")


def test_pictures_without_texture_do_not(tmp_path: Path) -> None:
    """Every depth matches such pictures."""
    cameras = tiny_rig(9)
    flat = np.full((36, 64, 3), 90, np.uint8)
    paths = write_pictures(tmp_path, cameras, 1, False, lambda *_: flat)
    write_transforms(tmp_path, transforms_of(cameras, paths))
    capture = open_capture(tmp_path)
    assert near_of(capture) == capture.near_m


def test_a_rig_that_looks_one_way_keeps_what_it_declares(tmp_path: Path) -> None:
    cameras = camera_rig(6, WIDTH_PX, HEIGHT_PX, float(np.radians(20)))
    capture = write(tmp_path / "with", cameras, 1000)
    seen = look(capture, range(1))
    assert seen is None
    assert nearplane.near_plane(capture, seen) == capture.near_m
    assert nearplane.near_planes(capture, seen) == ()
    capture = write(tmp_path / "without", cameras, 0)
    assert nearplane.near_plane(capture, look(capture, range(1))) is None
    assert said(checked(tmp_path / "without"), "near").startswith("0.2 units, by default")


def test_new_places_are_looked_for_from_where_the_rig_suggests(tmp_path: Path) -> None:
    capture = write(tmp_path / "c", close_rig(), 6000)
    found = prepare(TrainConfig(tmp_path / "c", tmp_path / "s"))
    assert not found.near_doubts
    assert capture.near_m is not None
    assert found.near_m < 0.9 * capture.near_m
    assert found.search_from_m == capture.near_m
    assert found.camera_near_m == tuple(planes_of(capture).values())
    assert found.training_planes == list(found.camera_near_m)
    given = prepare(TrainConfig(tmp_path / "c", tmp_path / "s", near_m=0.3))
    assert given.near_m == given.search_from_m == 0.3
    assert set(given.training_planes) == {0.3}
