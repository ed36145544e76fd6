"""The synthetic capture: complete, readable, and true to its own geometry."""

from __future__ import annotations

import hashlib
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pytest
from rich.console import Console

from codec.arrays import Doubles
from codec.camera import Camera
from codec.errors import InvalidError
from codec.rig import rig_depths
from codec.splats import Splats
from player.render.cpu import render_splats
from tests.support.commands import run_ok
from trainer.capture.capture import Capture
from trainer.capture.layout import open_capture
from trainer.synth.film import Studio, SynthConfig, check_config, spacing_m, synthesise
from trainer.synth.scene import (
    BALL_RADIUS_M,
    WALK_RADIUS_M,
    Scene,
    ball_place,
    camera_rig,
    foot_place,
    moving_cones,
)
from trainer.synth.surfels import cone_surfels

TINY = SynthConfig(
    Path("unset"), frames=3, cameras=4, held_out=1, width_px=64, height_px=36, points=300
)


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Capture:
    out = tmp_path_factory.mktemp("synth") / "made" / "capture"
    synthesise(replace(TINY, out=out), Console(quiet=True))
    return open_capture(out)


def project(xyz: npt.NDArray[np.floating], camera: Camera) -> Doubles:
    """(P, 3) column, row in pixels and depth in metres."""
    seen = xyz @ camera.w2c[:3, :3].T + camera.w2c[:3, 3]
    x, y, depth = seen.T
    columns, rows = camera.fx_px * x / depth + camera.cx_px, camera.fy_px * y / depth + camera.cy_px
    return np.stack([columns, rows, depth], axis=1)


def test_the_capture_is_complete(made: Capture) -> None:
    assert (made.layout, made.num_frames, made.fps) == ("dynerf", 3, 30.0)
    assert made.held_out == (2,)
    assert [c.camera.name for c in made.cameras] == ["cam00", "cam01", "cam02", "cam03"]
    assert made.points is not None
    assert len(made.points) == 300
    assert made.near_m is not None
    assert 0.9 < made.near_m < 1.3
    names = sorted(path.name for path in made.root.iterdir())
    assert names == [*(f"cam{i:02d}.mp4" for i in range(4)), "held_out.txt", "points.npz",
                     "poses_bounds.npy"]  # fmt: skip
    assert [path.name for path in made.root.parent.iterdir()] == ["capture"]


@cache
def scene_for(width_px: int) -> Scene:
    """The scene for pictures of a width."""
    return Scene(30.0, 0, WALK_RADIUS_M, spacing_m(width_px))


def test_videos_hold_what_was_drawn(made: Capture) -> None:
    scene = scene_for(64)
    rig = camera_rig(4, 64, 36, float(np.radians(200.0)))
    for index in (0, 2):
        assert np.allclose(made.cameras[index].camera.w2c, rig[index].w2c, atol=1e-12)
        drawn, _ = Studio(scene, rig[index]).film(2)
        error = made.open_images(index).read(2).astype(float) - drawn
        assert 10 * np.log10(255**2 / (error**2).mean()) > 48


def test_the_ball_is_where_the_cameras_see_it() -> None:
    scene = scene_for(192)
    checked = 0
    for camera in camera_rig(5, 192, 108, float(np.radians(200.0))):
        studio = Studio(scene, camera)
        for frame in (12, 24):
            picture, depth = studio.film(frame)[0], studio.depth(frame)
            centre = ball_place(frame / 30, 0)
            rows, columns = np.mgrid[:108, :192] + 0.5
            places = camera.unproject(columns, rows, depth.astype(np.float64))
            on_ball = np.abs(np.linalg.norm(places - centre, axis=-1) - BALL_RADIUS_M) < 0.03
            column, row, away = project(centre[None], camera)[0]
            radius_px = camera.fx_px * BALL_RADIUS_M / away
            is_cut = min(column, row, 192 - column, 108 - row) < radius_px
            if is_cut or on_ball.sum() < 0.9 * np.pi * radius_px**2:  # or partly hidden
                continue
            rows, columns = np.nonzero(on_ball)
            assert np.hypot(columns.mean() + 0.5 - column, rows.mean() + 0.5 - row) < 0.7
            assert np.sqrt(on_ball.sum() / np.pi) < radius_px + 1
            red, green, blue = picture[on_ball].mean(axis=0)
            assert red > green + 30 > blue + 60  # orange in the pictures, too
            checked += 1
    assert checked >= 4


def test_points_lie_on_what_the_cameras_see() -> None:
    scene, rig = scene_for(192), camera_rig(5, 192, 108, float(np.radians(200.0)))
    xyz, rgb = Studio(scene, rig[1]).sample_points(300, np.random.default_rng(0))
    studio = Studio(scene, rig[2])
    picture, depths = studio.film(0)[0], studio.depth(0)
    columns, rows, depth = project(xyz, rig[2]).T
    inside = (depth > 0.1) & (columns >= 0) & (columns < 192) & (rows >= 0) & (rows < 108)
    at = rows[inside].astype(int), columns[inside].astype(int)
    seen = np.abs(depths[at] / depth[inside] - 1) < 0.03  # the others are hidden here
    assert seen.mean() > 0.5
    error = np.abs(picture[at].astype(int) - rgb[inside])[seen].mean(axis=1)
    assert np.median(error) < 6


def test_the_scene_moves_and_the_room_stands_still() -> None:
    studio = Studio(scene_for(96), camera_rig(3, 96, 54, 1.0)[1])
    pictures = np.stack([studio.film(frame)[0] for frame in (0, 5, 10, 15)]).astype(int)
    change = np.abs(pictures - pictures[0]).max(axis=(0, 3))
    assert 0.03 < (change > 30).mean() < 0.5
    assert (change == 0).mean() > 0.3


def test_what_moves_is_hidden_and_shaded_like_the_room() -> None:
    """A picture of the parts put together is one of all Gaussians at once, whatever hides what."""
    for walk_m, frame in (WALK_RADIUS_M, 12), (2.6, 0):
        scene = Scene(30.0, 0, walk_m, spacing_m(96))
        for camera in camera_rig(4, 96, 54, float(np.radians(200.0))):
            at_once = Splats.concatenate([scene.moving(frame), scene.room()])
            wanted = np.clip(render_splats(at_once, camera, 0.05), 0, 1)
            error = Studio(scene, camera).film(frame)[0] / 255 - wanted
            assert np.abs(error).mean() < 0.01


def test_same_seed_same_bytes_other_seed_other_picture(tmp_path: Path, made: Capture) -> None:
    def digest(root: Path) -> dict[str, str]:
        return {p.name: hashlib.sha256(p.read_bytes()).hexdigest() for p in root.iterdir()}

    synthesise(replace(TINY, out=tmp_path / "again"), Console(quiet=True))
    assert digest(tmp_path / "again") == digest(made.root)
    synthesise(replace(TINY, out=tmp_path / "other", seed=3), Console(quiet=True))
    assert digest(tmp_path / "other")["cam01.mp4"] != digest(made.root)["cam01.mp4"]


@pytest.mark.parametrize("radius_m", [WALK_RADIUS_M, 2.5])
def test_a_standing_foot_stands(radius_m: float) -> None:
    for start in (0.0, 3.0, 7.0):
        steps = np.linspace(start, start + 0.47, 9)
        places = np.stack([foot_place(step, 0.0, 1.0, radius_m)[0] for step in steps])
        assert np.ptp(places, axis=0).max() < 1e-9
        assert places[0, 1] == 0.0
    for time_s in np.linspace(0, 3, 40):
        cones = np.array([cone.row() for cone in moving_cones(float(time_s), 1, radius_m)])
        lowest = np.maximum(cones[:, 1] + cones[:, 3], cones[:, 5] + cones[:, 7]).max()
        assert lowest < 0.035  # shoes and ball may sink into the floor by no more


def test_on_a_wide_circle_the_figure_passes_right_before_a_camera() -> None:
    cameras = camera_rig(16, 64, 36, float(np.radians(200.0)))
    depths = rig_depths(cameras)
    assert depths is not None
    nearest = {}
    room = Scene(30.0, 22, WALK_RADIUS_M, spacing_m(256)).room().means
    for radius_m in (WALK_RADIUS_M, 2.5):
        figure = cone_surfels(moving_cones(0.0, 22, radius_m), spacing_m(256), 22).places
        means = np.concatenate([room, figure])
        nearest[radius_m] = np.inf
        for camera in cameras:
            columns, rows, depth = camera.project(means)
            seen = (depth > 0.1) & (columns >= 0) & (columns < 64) & (rows >= 0) & (rows < 36)
            nearest[radius_m] = min(nearest[radius_m], float(depth[seen].min()))
    assert nearest[2.5] < 0.6 * depths[0]
    assert nearest[WALK_RADIUS_M] > 0.9 * depths[0]


def test_a_failure_leaves_nothing_behind(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def broken(self: Studio, frame: int) -> None:
        raise OSError("disk full")

    (tmp_path / "full").mkdir()
    (tmp_path / "full" / "mine").touch()
    for taken in (tmp_path / "full", tmp_path / "full" / "mine"):
        with pytest.raises(InvalidError, match="is not empty; remove it or name another"):
            synthesise(replace(TINY, out=taken), Console(quiet=True))
    with monkeypatch.context() as patch:
        patch.setattr(Studio, "film", broken)
        with pytest.raises(OSError, match="disk full"):
            synthesise(replace(TINY, out=tmp_path / "c"), Console(quiet=True))
    assert [p.name for p in tmp_path.rglob("*")] == ["full", "mine"]
    free = tmp_path / "free"
    free.mkdir()
    words = "--cameras", 5, "--held-out", 0, "--width-px", 32, "--height-px", 32, "--frames", 1
    told = run_ok("swings-synth", free, *words, "--points", 0)
    assert told == f"{free}: 5 cameras, 0 of them held out, 1 frames at 30 a second\n"
    assert (open_capture(free).points, open_capture(free).held_out) == (None, ())


def test_numbers_that_make_no_capture() -> None:
    for name, value in (
        ("frames", 0), ("cameras", 0), ("held_out", 3), ("held_out", -1), ("width_px", 8),
        ("height_px", 5000), ("fps", 0.0), ("fps", float("nan")), ("arc_deg", 360.0),
        ("walk_radius_m", 3.2), ("points", -1), ("seed", -1),
    ):  # fmt: skip
        with pytest.raises(InvalidError, match=f"{name}.* must be between"):
            check_config(replace(TINY, **{name: value}))  # type: ignore[arg-type]
