"""A camera path from a JSON file: a list of key frames, interpolated.

    [{"frame": 0, "position": [0, 1, -3], "look_at": [0, 1, 0], "fov_deg": 50},
     {"frame": 90, "w2c": [16 numbers, row by row]}]

A key frame has `position` with `look_at` (and `up` if wanted), or `w2c`, a world-to-camera matrix
(x right, y down, z forward). `fov_deg` is the vertical field of view; without it the default
camera's stays.

A camera path of nerfstudio is read, too, one pose a frame:

    {"camera_path": [{"camera_to_world": [16 numbers], "fov": vertical degrees}, ...]}

Its poses lead from camera to world, in OpenGL's axes: x right, y up, z backwards. They must be in
the coordinates of the stream: nerfstudio moves and scales a scene unless it is told not to.
"""

from __future__ import annotations

import json
import math
from bisect import bisect_right
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from codec.arrays import Doubles
from codec.camera import Camera
from codec.errors import InvalidError, SwingsError
from codec.pose import look_at, quat_of, rotation_of, slerp, world_to_camera

MAX_FILE_BYTES = 16 << 20
KEYS = {"frame", "w2c", "position", "look_at", "up", "fov_deg"}
OPENGL_FROM_OPENCV = np.diag([1.0, -1.0, -1.0, 1.0])


@dataclass(frozen=True, slots=True)
class Keyframe:
    """Where the camera is at `frame`."""

    frame: int
    position: Doubles  # (3,) metres, world
    quat: Doubles  # (4,) wxyz, unit: the world-to-camera rotation
    focal: float  # fy in picture heights


def read_keyframes(path: Path, camera: Camera, up: Doubles) -> Callable[[float], Camera]:
    """The path in the file `path`; `camera` gives the picture's size and what the file leaves out.

    Before the first key frame and after the last one the camera stands still. Raises InvalidError.
    """
    try:
        with open(path, "rb") as file:
            data = file.read(MAX_FILE_BYTES + 1)
        value = json.loads(data)
    except OSError as error:
        raise InvalidError(f"camera path {path}: {error.strerror}") from error
    except (ValueError, RecursionError) as error:
        raise InvalidError(f"camera path {path} is not JSON: {error}") from error
    if isinstance(value, dict):
        try:
            value = _of_nerfstudio(value)
        except InvalidError as error:
            raise InvalidError(f"camera path {path}: {error}") from error
    if not isinstance(value, list) or not value:
        raise InvalidError(f"camera path {path} is not a list of key frames")
    keyframes: list[Keyframe] = []
    for number, entry in enumerate(value):
        try:
            keyframes.append(_keyframe(entry, camera, up))
            if number and keyframes[-1].frame <= keyframes[-2].frame:
                raise InvalidError("its frame is not after the previous key frame")
        except SwingsError as error:
            raise InvalidError(f"camera path {path}, key frame {number}: {error}") from error
    return lambda frame: _between(keyframes, frame, camera)


def _of_nerfstudio(value: Mapping[str, Any]) -> list[dict[str, Any]]:
    """The key frames, as in a file of ours, of a camera path of nerfstudio."""
    poses = value.get("camera_path")
    if not isinstance(poses, list) or not poses:
        raise InvalidError("it is no list of key frames and has no camera_path (nerfstudio)")
    entries: list[dict[str, Any]] = []
    for number, pose in enumerate(poses):
        try:
            c2w = np.array(pose["camera_to_world"], np.float64).reshape(4, 4)
            w2c = np.linalg.inv(c2w @ OPENGL_FROM_OPENCV)
        except (KeyError, TypeError, ValueError, OverflowError, np.linalg.LinAlgError) as error:
            raise InvalidError(f"pose {number} has no camera_to_world of 4x4 numbers") from error
        entries.append({"frame": number, "w2c": w2c.ravel().tolist()})
        if "fov" in pose:
            entries[-1]["fov_deg"] = pose["fov"]
    return entries


def _numbers(entry: Mapping[str, Any], key: str, count: int) -> Doubles:
    found = entry[key]
    if (
        not isinstance(found, list)
        or len(found) != count
        or not all(type(x) in (int, float) and math.isfinite(x) for x in found)
    ):
        raise InvalidError(f"{key} is not {count} numbers")
    return np.array(found, np.float64)


def _keyframe(entry: Any, camera: Camera, up: Doubles) -> Keyframe:
    if not isinstance(entry, dict):
        raise InvalidError("it is not a JSON object")
    unknown = set(entry) - KEYS
    if unknown:
        raise InvalidError(f"{min(unknown)!r} is not one of {', '.join(sorted(KEYS))}")
    frame = entry.get("frame")
    if type(frame) is not int or frame < 0:
        raise InvalidError("frame is missing or not a whole number of 0 or more")
    if "w2c" in entry:
        if {"position", "look_at", "up"} & set(entry):
            raise InvalidError("give either w2c or position and look_at")
        w2c = _numbers(entry, "w2c", 16).reshape(4, 4)
    elif "position" in entry and "look_at" in entry:
        if "up" in entry:
            up = _numbers(entry, "up", 3)
        w2c = look_at(_numbers(entry, "position", 3), _numbers(entry, "look_at", 3), up)
    else:
        raise InvalidError("it has neither w2c nor position and look_at")
    focal = camera.fy_px / camera.height_px
    if "fov_deg" in entry:
        fov_deg = entry["fov_deg"]
        if type(fov_deg) not in (int, float) or not 0 < fov_deg < 180:
            raise InvalidError("fov_deg is not between 0 and 180")
        focal = 0.5 / math.tan(math.radians(fov_deg) / 2)
    posed = replace(camera, w2c=w2c)  # checks the pose
    return Keyframe(frame, posed.position, quat_of(w2c[:3, :3]), focal)


def _between(keyframes: list[Keyframe], frame: float, camera: Camera) -> Camera:
    after = bisect_right(keyframes, frame, key=lambda keyframe: keyframe.frame)
    first = keyframes[max(after - 1, 0)]
    last = keyframes[min(after, len(keyframes) - 1)]
    share = (frame - first.frame) / (last.frame - first.frame) if last.frame > first.frame else 0.0
    share = min(max(share, 0.0), 1.0)
    focal = (1 - share) * first.focal + share * last.focal
    rotation = rotation_of(slerp(first.quat, last.quat, share))
    position = (1 - share) * first.position + share * last.position
    fy_px = focal * camera.height_px
    return replace(
        camera,
        w2c=world_to_camera(rotation, position),
        fy_px=fy_px,
        fx_px=camera.fx_px * fy_px / camera.fy_px,
    )
