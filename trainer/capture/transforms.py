"""The transforms.json of the Nerfstudio layout: poses and lenses, and the files they belong to.

nerfstudio.py describes the layout.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path, PurePosixPath
from typing import Any

import numpy as np

from codec.arrays import Doubles
from codec.camera import Camera
from codec.errors import CodecError, InvalidError
from codec.files import opened_regular
from codec.pose import world_to_camera
from trainer.errors import CaptureError

from .footage import size_of
from .lens import Lens, check_optics
from .picturefiles import FRAMES_NAME, safe_path
from .points import MAX_COORDINATE_M
from .video import VIDEO_SUFFIXES

TRANSFORMS_NAME = "transforms.json"

START_KEY = "start_s"
"""In the entry of a video: the time in it at which frame 0 of the capture is, seconds after its
first frame. `fps` is then the capture's rate, and each of its frames the nearest of the video."""

CAMERA_MODELS = frozenset({"SIMPLE_PINHOLE", "PINHOLE", "SIMPLE_RADIAL", "RADIAL", "OPENCV"})

_OPENCV_FROM_OPENGL = np.array([1.0, -1.0, -1.0])
"""Signs of the camera's axes x, y, z."""


@dataclass(frozen=True, slots=True)
class Transforms:
    """A transforms.json, or one of its entries merged with what the file says for all of them."""

    path: Path
    value: Mapping[str, Any]
    sizes: dict[PurePosixPath, tuple[int, int]] = field(default_factory=dict)
    """Width and height of pictures whose entries give none, in pixels."""

    @classmethod
    def read(cls, path: Path) -> Transforms:
        """The file at `path`. Raises CaptureError unless it is a JSON object."""
        try:
            with opened_regular(path) as file:
                value = json.load(file)
        except CodecError as error:
            raise CaptureError(str(error)) from error
        except (ValueError, RecursionError) as error:
            raise CaptureError(f"{path}: not JSON: {error}") from error
        if not isinstance(value, dict):
            raise CaptureError(f"{path}: the top of the JSON is not an object")
        return cls(path, value)

    @property
    def root(self) -> Path:
        return self.path.parent

    def error(self, text: str) -> CaptureError:
        return CaptureError(f"{self.path}: {text}")

    def merged(self, frame: Mapping[str, Any]) -> Transforms:
        return Transforms(self.path, {**self.value, **frame}, self.sizes)

    def size_of(self, below: PurePosixPath) -> tuple[int, int]:
        """Width and height of the pictures of an entry, in pixels: of the first one of its camera,
        if its path tells which that is, else of its folder. Raises CaptureError."""
        by_frame = FRAMES_NAME in below.parts[-3:-2]
        key = PurePosixPath(below.name) if by_frame else below.parent
        if key not in self.sizes or below.suffix.lower() in VIDEO_SUFFIXES:
            self.sizes[key] = size_of(self.root / below)
        return self.sizes[key]

    def number(self, key: str, default: float | None = None) -> float:
        """The finite number under `key`. Raises CaptureError, also where it is missing and has no
        default."""
        number = self.value.get(key)
        number = default if number is None else number
        if number is None:
            raise self.error(f"lacks {key}")
        if isinstance(number, int | float) and not isinstance(number, bool):
            with suppress(OverflowError):
                if math.isfinite(number):
                    return float(number)
        raise self.error(f"{key} is {str(number)[:40]!r}, not a number")


@dataclass(frozen=True, slots=True)
class Entry:
    """An entry of `frames`."""

    path: PurePosixPath
    camera: Camera
    """Named by its file_path."""
    lens: Lens
    time: float | None
    mask: PurePosixPath | None
    start_s: float | None = None
    """See START_KEY."""


def read_entries(transforms: Transforms) -> list[Entry]:
    """The entries of `frames`. Raises CaptureError."""
    frames = transforms.value.get("frames")
    if not isinstance(frames, list) or not frames:
        raise transforms.error("`frames` is not a list of entries")
    entries: dict[PurePosixPath, Entry] = {}
    for number, frame in enumerate(frames):
        if not isinstance(frame, dict) or not isinstance(frame.get("file_path"), str):
            raise transforms.error(f"entry {number} of `frames` has no file_path")
        entry = _read_entry(transforms.merged(frame))
        if entry.path in entries:
            raise transforms.error(f"{entry.path} is listed twice")
        entries[entry.path] = entry
    return list(entries.values())


def _read_entry(given: Transforms) -> Entry:
    """One entry, merged with what the file says for all of them."""
    value, below = given.value, safe_path(given.value["file_path"], given.path)
    _check_model(given, below)
    camera = _read_camera(given, below)
    lens = Lens(**{key: given.number(key, 0.0) for key in ("k1", "k2", "k3", "p1", "p2")})
    check_optics(camera, lens, given.path)
    time = given.number("time") if "time" in value else None
    mask = value.get("mask_path")
    if not isinstance(mask, str | None):
        raise given.error(f"{below}: mask_path is {str(mask)[:40]!r}, not a path")
    start_s = given.number(START_KEY) if START_KEY in value else None
    mask_path = None if mask is None else safe_path(mask, given.path)
    return Entry(below, camera, lens, time, mask_path, start_s)


def _check_model(given: Transforms, below: PurePosixPath) -> None:
    """Raises CaptureError for a camera model that is not read."""
    model, fisheye = given.value.get("camera_model", "OPENCV"), given.value.get("is_fisheye")
    if model not in CAMERA_MODELS or fisheye:
        raise given.error(
            f"{below}: camera_model {model}{' (fisheye)' * bool(fisheye)} is not read; undistort "
            "the pictures first"
        )
    if given.number("k4", 0.0) != 0:
        raise given.error(f"{below}: distortion by k4 is not read; undistort first")


def _read_camera(given: Transforms, below: PurePosixPath) -> Camera:
    """The camera of an entry, named by its file_path."""
    pose = _read_pose(given, below)
    if any(given.value.get(side) is None for side in "wh"):
        given = given.merged(dict(zip("wh", given.size_of(below), strict=True)))
    width, height = given.number("w"), given.number("h")
    if not (width.is_integer() and height.is_integer()):
        raise given.error(f"{below}: size {width:g}x{height:g} px is not whole")
    fx = given.number("fl_x", _focal_px(given, "camera_angle_x", width))
    fy = given.number("fl_y", _focal_px(given, "camera_angle_y", height) or fx)
    cx, cy = given.number("cx", width / 2), given.number("cy", height / 2)
    try:
        return Camera(str(below), int(width), int(height), fx, fy, cx, cy, pose)
    except InvalidError as error:
        raise given.error(str(error)) from error


def _focal_px(given: Transforms, key: str, side_px: float) -> float | None:
    """The focal length of Blender's angle of view over a side; None where it is not given."""
    if given.value.get(key) is None:
        return None
    angle_rad = given.number(key)
    if not 0 < angle_rad < math.pi:
        raise given.error(f"{key} is {angle_rad:g}; must be above 0 and below pi")
    return side_px / 2 / math.tan(angle_rad / 2)


def _read_pose(given: Transforms, below: PurePosixPath) -> Doubles:
    """(4, 4) world to camera of an entry, OpenCV axes."""
    try:
        matrix = np.array(given.value.get("transform_matrix"), np.float64)
    except (ValueError, TypeError, OverflowError):
        matrix = np.zeros(0)
    if matrix.shape not in ((4, 4), (3, 4)):
        raise given.error(f"{below}: transform_matrix is not a 4x4 matrix of numbers")
    if not (np.abs(matrix) <= MAX_COORDINATE_M).all():
        raise given.error(
            f"{below}: transform_matrix has a number over 1e9 or one that is not finite"
        )
    return world_to_camera((matrix[:3, :3] * _OPENCV_FROM_OPENGL).T, matrix[:3, 3])
