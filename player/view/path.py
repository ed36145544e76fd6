"""Camera paths: which camera looks at the scene in which frame.

A path is written as `default`, `camera:NAME`, `orbit`, `orbit:DEGREES` or the name of a JSON file;
a place in a stream as a frame, `30`, or a time, `2.5s`. The file is a list of key frames,
interpolated:

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
import logging
import math
import re
from bisect import bisect_right
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from codec.arrays import Doubles
from codec.camera import MAX_IMAGE_PX, Camera, look_at, quat_of, rotation_of, slerp, world_to_camera
from codec.console import option
from codec.errors import InvalidError, SwingsError
from codec.framerange import MAX_DIGITS, FrameRange
from codec.rig import rig_up
from codec.stream.manifest import Manifest
from codec.stream.views import scene_centre, turned

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


_TEXT = re.compile(rf"(\d{{1,{MAX_DIGITS}}})|(\d{{1,{MAX_DIGITS}}}(?:\.\d*)?|\.\d+)s", re.ASCII)


@dataclass(frozen=True, slots=True)
class Moment:
    """A frame, or the frame that shows at a time."""

    frame: int | None = None
    time_s: float | None = None
    """From the first frame on, at the stream's own rate. Counts where there is no `frame`."""

    def __str__(self) -> str:
        return f"{self.time_s:g}s" if self.frame is None else str(self.frame)

    @staticmethod
    def parse(text: str) -> Moment:
        """The moment in a text such as `30` or `2.5s`. Raises InvalidError."""
        match = _TEXT.fullmatch(text)
        if match is None:
            raise InvalidError(
                f"{text[:40]!r} is neither a frame, such as 30, nor a time, such as 2.5s"
            )
        if match[1] is not None:
            return Moment(frame=int(match[1]))
        return Moment(time_s=float(match[2]))

    def of(self, fps: float) -> int:
        """The number of the frame in a stream of that rate."""
        if self.frame is not None:
            return self.frame
        assert self.time_s is not None
        # A time that is written to the last digit belongs to the frame that begins then.
        return math.floor(self.time_s * fps + 1e-6)


MOMENT = option("FRAME|SECONDSs", Moment.parse)
"""For options that take a Moment: Annotated[Moment, MOMENT]."""


log = logging.getLogger(__name__)

CameraPath = Callable[[float], Camera]
"""Gives the camera of a frame."""

ENDLESS_TURN_S = 10.0
"""Duration of a turn around a stream whose end is not known, in seconds."""

MAX_UNASKED_PX = 4096
"""Longest side of a picture without a requested size, in pixels."""


@dataclass(frozen=True, slots=True)
class Size:
    """A picture's size in pixels."""

    width_px: int
    height_px: int

    @staticmethod
    def parse(text: str) -> Size:
        """The size in a text such as `1280x720`. Raises InvalidError."""
        width, cross, height = text.lower().partition("x")
        if not (cross and width.isdecimal() and height.isdecimal()):
            raise InvalidError(f"size {text!r} is not WIDTHxHEIGHT, such as 1280x720")
        size = Size(int(width), int(height))
        if not (1 <= size.width_px <= MAX_IMAGE_PX and 1 <= size.height_px <= MAX_IMAGE_PX):
            raise InvalidError(f"size {text!r} is not within 1..{MAX_IMAGE_PX} pixels")
        return size


def orbit(manifest: Manifest, start: Camera, frames: FrameRange, arc_rad: float) -> CameraPath:
    """Around the scene's centre, from `start` at the first of `frames` and back to it at their end.

    arc_rad: 2 pi goes once around; less swings half of it to either side.
    """
    centre, axis = scene_centre(manifest), rig_up(manifest.cameras)
    period = frames.count or max(1, round(ENDLESS_TURN_S * manifest.fps))
    whole = arc_rad >= 2 * math.pi - 1e-9

    def path(frame: float) -> Camera:
        phase_rad = 2 * math.pi * ((frame - frames.first) % period) / period
        angle_rad = phase_rad if whole else arc_rad / 2 * math.sin(phase_rad)
        return turned(start, centre, axis, angle_rad)

    return path


def sane_size(camera: Camera) -> Size | None:
    """The size at which `camera` is drawn unasked, if its own is larger than anybody wants."""
    longest_px = max(camera.width_px, camera.height_px)
    if longest_px <= MAX_UNASKED_PX:
        return None
    scale = MAX_UNASKED_PX / longest_px
    size = Size(max(1, round(camera.width_px * scale)), max(1, round(camera.height_px * scale)))
    log.warning(
        "the camera has %dx%d pixels; drawing %dx%d (--size sets another size)",
        camera.width_px,
        camera.height_px,
        size.width_px,
        size.height_px,
    )
    return size


def check_path(text: str) -> None:
    """Raises InvalidError for a text that is not a camera path, whatever the stream."""
    kind, colon, rest = text.partition(":")
    if kind == "orbit" and colon:
        _degrees(rest)
    elif not (text in ("default", "orbit") or (kind == "camera" and rest)):
        if not text.endswith(".json"):
            raise InvalidError(
                f"camera path {text!r} is not one of default, camera:NAME, orbit, orbit:DEGREES "
                "or a .json file"
            )
        if not Path(text).is_file():
            raise InvalidError(f"camera path: there is no file {text}")


def _degrees(text: str) -> float:
    try:
        degrees = float(text)
    except ValueError:
        degrees = math.nan
    if not 0 < degrees <= 360:
        raise InvalidError(f"camera path: an orbit of {text!r} degrees is not within 0..360")
    return degrees


def camera_path(text: str, manifest: Manifest, size: Size | None, frames: FrameRange) -> CameraPath:
    """The path that `text` describes in the stream of `manifest`.

    size: the pictures' size; None keeps that of the camera, unless it is enormous.
    frames: those that will be shown.
    """
    check_path(text)
    kind, _, rest = text.partition(":")
    start = manifest.camera(rest if kind == "camera" else None)
    if size is None:
        size = sane_size(start)
    if size is not None:
        start = start.fitted(size.width_px, size.height_px)
    if kind == "orbit":
        degrees = _degrees(rest) if rest else 360.0
        return orbit(manifest, start, frames, math.radians(degrees))
    if text.endswith(".json") and kind != "camera":
        return read_keyframes(Path(text), start, rig_up(manifest.cameras))
    return lambda frame: start
