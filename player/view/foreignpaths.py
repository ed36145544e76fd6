"""Camera paths of other programs, as key frames of one frame each.

    nerfstudio   {"camera_path": [{"camera_to_world": [16 numbers], "fov": vertical degrees}, ...]}
    Blender      {"camera_angle_x": radians, "frames": [{"transform_matrix": 4x4}, ...]}, as its
                 add-ons for NeRF write it

Both have poses from camera to world, in OpenGL's axes: x right, y up, z backwards. They must be in
the coordinates of the stream: nerfstudio moves and scales a scene unless it is told not to.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from codec.errors import InvalidError

_OPENGL_FROM_OPENCV = np.diag([1.0, -1.0, -1.0, 1.0])


def keyframes_of(value: Mapping[str, Any], aspect: float) -> list[dict[str, Any]]:
    """The entries of keyframes.py for another program's path. aspect: width over height of the
    picture, where the path does not give its own. Raises InvalidError."""
    if "camera_path" in value:
        poses, name = value["camera_path"], "camera_to_world"
    elif "frames" in value:
        poses, name = value["frames"], "transform_matrix"
    else:
        raise InvalidError("it has neither camera_path (nerfstudio) nor frames (Blender)")
    if not isinstance(poses, list) or not poses:
        raise InvalidError(f"its {name} are not in a list of poses")
    if "w" in value and "h" in value:
        aspect = _positive(value, "w") / _positive(value, "h")
    fov_deg = None
    if "camera_angle_x" in value:
        across = math.tan(min(_positive(value, "camera_angle_x"), math.pi) / 2)
        fov_deg = math.degrees(2 * math.atan(across / aspect))
    return [_entry(number, pose, name, fov_deg) for number, pose in enumerate(poses)]


def _entry(number: int, pose: Any, name: str, fov_deg: float | None) -> dict[str, Any]:
    try:
        c2w = np.array(pose[name], np.float64).reshape(4, 4)
        w2c = np.linalg.inv(c2w @ _OPENGL_FROM_OPENCV)
    except (KeyError, TypeError, ValueError, OverflowError, np.linalg.LinAlgError) as error:
        raise InvalidError(f"pose {number} has no {name} of 4x4 numbers") from error
    entry: dict[str, Any] = {"frame": number, "w2c": w2c.ravel().tolist()}
    if "fov" in pose:
        entry["fov_deg"] = _positive(pose, "fov")
    elif fov_deg is not None:
        entry["fov_deg"] = fov_deg
    return entry


def _positive(value: Mapping[str, Any], key: str) -> float:
    found = value[key]
    if isinstance(found, bool) or not isinstance(found, int | float) or not 0 < found < 1e6:
        raise InvalidError(f"{key} is not a positive number")
    return float(found)
