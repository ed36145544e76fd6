"""Mathematics of camera paths, key frames and the window's view."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from codec.arrays import Doubles
from codec.camera import Camera, look_at
from codec.errors import InvalidError
from codec.framerange import FrameRange
from codec.stream.views import scene_centre
from player.view.mouse import view_of
from player.view.path import Moment, Size, camera_path, read_keyframes
from tests.support.hosted_streams import ring_of_cameras, small_manifest

MANIFEST = small_manifest()
CENTRE = np.array([0.0, 0.0, 4.0])
KEY = '{"frame": 5, "position": [0, 0, 0], "look_at": [0, 0, 4]}'
UNIT = np.eye(4).tolist()


def seen_at_px(camera: Camera, point: Doubles) -> Doubles:
    return np.array(camera.project(point)[:2])


def test_the_scene_is_where_the_cameras_look() -> None:
    np.testing.assert_allclose(scene_centre(MANIFEST), CENTRE, atol=1e-9)
    alone = small_manifest(cameras=ring_of_cameras()[:1], bounds=((0, 0, 0), (2, 4, 6)))
    np.testing.assert_allclose(scene_centre(alone), [1, 2, 3])
    # Not where cameras that look the same way cross.
    places = [np.array([x, 0.0, 0.0]) for x in (-0.05, 0.05)]
    first = MANIFEST.camera()
    pair = tuple(
        replace(first, name=f"c{n}", w2c=look_at(place, CENTRE, np.array([0.0, -1, 0])))
        for n, place in enumerate(places)
    )
    alike = small_manifest(cameras=pair, bounds=((-2, -2, 2), (2, 2, 8)))
    np.testing.assert_allclose(scene_centre(alike), [0, 0, 5])


def test_an_orbit_goes_once_around_and_starts_at_the_default_camera() -> None:
    path = camera_path("orbit", MANIFEST, None, FrameRange(10, 50))
    np.testing.assert_allclose(path(10).w2c, MANIFEST.camera("c0").w2c, atol=1e-12)
    np.testing.assert_allclose(path(50).w2c, path(10).w2c, atol=1e-9)
    places = np.array([path(frame).position for frame in range(10, 50)])
    np.testing.assert_allclose(np.linalg.norm(places - CENTRE, axis=1), 4, atol=1e-9)
    steps = np.linalg.norm(np.diff(places, axis=0), axis=1)
    np.testing.assert_allclose(steps, steps[0])
    others = {tuple(np.round(camera.position, 6) + 0.0) for camera in MANIFEST.cameras}
    assert others <= {tuple(np.round(place, 6) + 0.0) for place in places}
    for frame in range(10, 50):
        np.testing.assert_allclose(seen_at_px(path(frame), CENTRE), (32, 24), atol=1e-6)


def test_an_arc_swings_to_both_sides_and_back() -> None:
    path = camera_path("orbit:30", MANIFEST, None, FrameRange(0, 40))
    start = path(0).position - CENTRE
    turns_deg = [
        math.degrees(math.acos(min(1.0, (path(f).position - CENTRE) @ start / 16)))
        for f in range(40)
    ]
    assert max(turns_deg) == pytest.approx(15)
    np.testing.assert_allclose(path(20).w2c, path(0).w2c, atol=1e-9)
    endless = camera_path("orbit", MANIFEST, None, FrameRange(0, None))
    np.testing.assert_allclose(endless(300).w2c, endless(0).w2c, atol=1e-9)


def test_named_cameras() -> None:
    path = camera_path("camera:c2", MANIFEST, Size(32, 24), FrameRange())
    assert path(7).name == "c2"
    assert (path(7).width_px, path(7).fx_px) == (32, 30)
    assert camera_path("default", MANIFEST, None, FrameRange())(3).name == "c0"
    with pytest.raises(InvalidError, match="c0, c1, c2, c3"):
        camera_path("camera:nobody", MANIFEST, None, FrameRange())


def test_key_frames_are_met_and_joined(tmp_path: Path) -> None:
    file = tmp_path / "path.json"
    w2c = [float(x) for x in MANIFEST.camera("c1").w2c.ravel()]
    keys = [
        {"frame": 10, "position": [0, 0, 0], "look_at": [0, 0, 4], "fov_deg": 90},
        {"frame": 20, "w2c": w2c},
    ]
    file.write_text(json.dumps(keys))
    path = camera_path(str(file), MANIFEST, Size(64, 48), FrameRange())
    for frame in (0, 10):
        np.testing.assert_allclose(path(frame).w2c, np.eye(4), atol=1e-9)
        assert path(frame).fy_px == pytest.approx(24)
    for frame in (20, 99):
        np.testing.assert_allclose(path(frame).w2c, MANIFEST.camera("c1").w2c, atol=1e-9)
        assert path(frame).fy_px == pytest.approx(60)
    middle = path(15)
    expected = (np.zeros(3) + MANIFEST.camera("c1").position) / 2
    np.testing.assert_allclose(middle.position, expected, atol=1e-9)
    assert math.degrees(math.acos(middle.forward[2])) == pytest.approx(45)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("{", "is not JSON"),
        ("[]", "is not a list"),
        ("[3]", "key frame 0: it is not a JSON object"),
        ('[{"frame": 0}]', "neither w2c nor position"),
        ('[{"frame": -1, "w2c": []}]', "frame is missing"),
        ('[{"frame": 0, "w2c": [1]}]', "w2c is not 16 numbers"),
        ('[{"frame": 0, "w2c": [2,0,0,0,0,2,0,0,0,0,2,0,0,0,0,1]}]', "not a rotation"),
        ('[{"frame": 0, "position": [0,0,0], "look_at": [0,1,0]}]', "straight up"),
        ('[{"frame": 0, "position": [0,0,0], "look_at": [0,0,1], "fov_deg": 0}]', "fov_deg"),
        ('[{"frame": 0, "position": [0,0,0], "look_at": [0,0,1], "zoom": 1}]', "'zoom'"),
        ('[{"frame": 0, "position": [0,0,NaN], "look_at": [0,0,1]}]', "position"),
        (f"[{KEY}, {KEY}]", "key frame 1: its frame is not after"),
        ("{}", "no list of key frames and has no camera_path"),
        ('{"camera_path": []}', "no list of key frames and has no camera_path"),
        ('{"camera_path": [3]}', "pose 0 has no camera_to_world"),
        ('{"camera_path": [{"camera_to_world": [[1, 2]]}]}', "pose 0 has no camera_to_world"),
        (f'{{"camera_path": [{{"camera_to_world": {UNIT}, "fov": "x"}}]}}', "fov_deg is not"),
        (f'{{"camera_path": [{{"camera_to_world": {UNIT}, "fov": 200}}]}}', "fov_deg is not"),
    ],
)
def test_bad_key_frames_say_what_is_wrong(tmp_path: Path, text: str, message: str) -> None:
    file = tmp_path / "path.json"
    file.write_text(text)
    with pytest.raises(InvalidError, match=message) as found:
        camera_path(str(file), MANIFEST, None, FrameRange())
    assert "\n" not in str(found.value)


def test_words_that_are_no_path_and_no_size() -> None:
    for text in ("orbiting", "orbit:0", "orbit:x", "orbit:400", "camera:", "a.json"):
        with pytest.raises(InvalidError, match="camera path"):
            camera_path(text, MANIFEST, None, FrameRange())
    assert Size.parse("1280x720") == Size(1280, 720)
    for text in ("1280", "x720", "0x5", "99999x5", "5x5x5"):
        with pytest.raises(InvalidError, match="size"):
            Size.parse(text)


def test_the_view_turns_moves_and_zooms_about_the_scene() -> None:
    camera = MANIFEST.camera()
    view = view_of(MANIFEST)
    np.testing.assert_allclose(view.applied(camera).w2c, camera.w2c, atol=1e-12)
    view.drag_turn(100, 40)
    seen = view.applied(camera)
    assert np.linalg.norm(seen.position - CENTRE) == pytest.approx(4)
    np.testing.assert_allclose(seen_at_px(seen, CENTRE), (32, 24), atol=1e-6)
    near_side_px = seen_at_px(seen, CENTRE - (0, 0, 1))
    assert near_side_px[0] > 33
    assert near_side_px[1] > 25
    view.scroll(0, 1)
    assert np.linalg.norm(view.applied(camera).position - CENTRE) == pytest.approx(3.6)
    view.drag_pan(6, -3, camera.fy_px)
    # The centre follows the mouse.
    np.testing.assert_allclose(seen_at_px(view.applied(camera), CENTRE), (38, 21), atol=1e-6)
    view.drag_turn(0, 1e9)
    assert abs(view.tilt_rad) <= math.pi / 2
    view.reset()
    np.testing.assert_allclose(view.applied(camera).w2c, camera.w2c, atol=1e-12)


UP = np.array([0.0, -1.0, 0.0])
OPENGL = np.diag([1.0, -1.0, -1.0, 1.0])


def camera_at(x: float, fov_deg: float) -> Camera:
    w2c = look_at(np.array([x, 0.3, -2.0]), np.array([0.1, 0.0, 0.5]), UP)
    focal_px = 24 / np.tan(np.radians(fov_deg) / 2)
    return Camera("c", 64, 48, focal_px, focal_px, 32, 24, w2c)


START = camera_at(3.0, 60)


def test_a_path_of_nerfstudio_has_one_pose_a_frame(tmp_path: Path) -> None:
    path = [camera_at(0.2 * x, 50) for x in range(4)]
    poses = [np.linalg.inv(camera.w2c) @ OPENGL for camera in path]
    entries = [{"camera_to_world": pose.ravel().tolist()} for pose in poses]
    file = tmp_path / "path.json"
    for fov_is_known in (True, False):  # without it the default camera's angle stays
        fov = {"fov": 50} if fov_is_known else {}
        camera_path = [entry | fov for entry in entries]
        file.write_text(json.dumps({"camera_type": "perspective", "camera_path": camera_path}))
        found = read_keyframes(file, START, UP)
        for frame, expected in enumerate(path):
            fy_px = (expected if fov_is_known else START).fy_px
            np.testing.assert_allclose(found(frame).w2c, expected.w2c, atol=1e-9)
            assert found(frame).fy_px == pytest.approx(fy_px)


@given(st.integers(0, 10**6), st.sampled_from([10.0, 12.5, 24.0, 25.0, 30.0, 29.97, 60.0]))
def test_a_moment_is_a_frame_or_a_time(frame: int, fps: float) -> None:
    assert Moment.parse(f"{frame / fps:.9f}s").of(fps) == frame
    assert Moment.parse(f"{(frame + 0.5) / fps:.9f}s").of(fps) == frame
    moment = Moment.parse(str(frame))
    assert moment.of(fps) == frame
    assert Moment.parse(str(moment)) == moment


@pytest.mark.parametrize(
    ("text", "time_s"),
    [
        *(("2.5s", 2.5), ("0s", 0.0), (".25s", 0.25), ("3.s", 3)),
        *((wrong, None) for wrong in ("", "-1", "1.5", "s", "-2s", "nan", "1e3s", "9" * 30)),
        ("\u0661", None),
    ],
)
def test_words_of_moments(text: str, time_s: float | None) -> None:
    if time_s is None:
        with pytest.raises(InvalidError):
            Moment.parse(text)
        return
    moment = Moment.parse(text)
    assert moment == Moment(time_s=time_s)
    assert Moment.parse(str(moment)) == moment
