"""Camera paths of nerfstudio and Blender."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from codec.camera import Camera
from codec.errors import InvalidError
from codec.pose import look_at
from player.view.keyframes import read_keyframes

UP = np.array([0.0, -1.0, 0.0])
OPENGL = np.diag([1.0, -1.0, -1.0, 1.0])


def camera_at(x: float, fov_deg: float) -> Camera:
    w2c = look_at(np.array([x, 0.3, -2.0]), np.array([0.1, 0.0, 0.5]), UP)
    focal_px = 24 / np.tan(np.radians(fov_deg) / 2)
    return Camera("c", 64, 48, focal_px, focal_px, 32, 24, w2c)


PATH = [camera_at(0.2 * x, 40 + x) for x in range(4)]
START = camera_at(3.0, 60)


def c2w(camera: Camera) -> np.ndarray:
    pose: np.ndarray = np.linalg.inv(camera.w2c) @ OPENGL
    return pose


def read(folder: Path, value: Any) -> list[Camera]:
    file = folder / "path.json"
    file.write_text(json.dumps(value))
    path = read_keyframes(file, START, UP)
    return [path(frame) for frame in range(len(PATH))]


def assert_same(found: list[Camera], expected: list[Camera]) -> None:
    for one, other in zip(found, expected, strict=True):
        np.testing.assert_allclose(one.w2c, other.w2c, atol=1e-9)
        np.testing.assert_allclose(one.intrinsics, other.intrinsics, atol=1e-9)


def test_nerfstudio_s_poses_are_one_a_frame(tmp_path: Path) -> None:
    poses = [
        {"camera_to_world": c2w(camera).ravel().tolist(), "fov": 40 + number, "aspect": 1}
        for number, camera in enumerate(PATH)
    ]
    value = {"camera_type": "perspective", "render_height": 480, "fps": 24, "camera_path": poses}
    assert_same(read(tmp_path, value), PATH)


@pytest.mark.parametrize("size", [{}, {"w": 64, "h": 48}])
def test_blender_s_angle_goes_across_the_picture(size: dict[str, int], tmp_path: Path) -> None:
    path = [camera_at(0.2 * x, 50) for x in range(4)]
    across_rad = 2 * np.arctan(np.tan(np.radians(50) / 2) * 64 / 48)
    frames = [{"file_path": "./r", "transform_matrix": c2w(c).tolist()} for c in path]
    found = read(tmp_path, {"camera_angle_x": across_rad, "frames": frames, **size})
    assert_same(found, path)
    kept = read(tmp_path, {"frames": frames})  # without an angle, the default camera's stays
    assert [c.fy_px for c in kept] == pytest.approx([START.fy_px] * 4)


@pytest.mark.parametrize(
    ("value", "message"),
    [
        ({}, "neither camera_path"),
        ({"frames": []}, "list of poses"),
        ({"frames": [3]}, "pose 0 has no transform_matrix"),
        ({"frames": [{"transform_matrix": [[1, 2]]}]}, "pose 0 has no transform_matrix"),
        ({"frames": [{"transform_matrix": np.zeros((4, 4)).tolist()}]}, "pose 0 has no"),
        ({"frames": [{"transform_matrix": (2 * np.eye(4)).tolist()}]}, "key frame 0"),
        ({"camera_path": [{"camera_to_world": np.eye(4).tolist(), "fov": "x"}]}, "fov is not"),
        ({"camera_path": [{"camera_to_world": np.eye(4).tolist(), "fov": 200}]}, "fov_deg"),
        ({"camera_angle_x": -1, "frames": [{}]}, "camera_angle_x is not"),
    ],
)
def test_what_is_not_a_path_is_one_line(value: Any, message: str, tmp_path: Path) -> None:
    with pytest.raises(InvalidError, match=message) as found:
        read(tmp_path, value)
    assert "\n" not in str(found.value)
