"""The transforms.json of the Nerfstudio layout: poses and lenses, and the files they belong to.

nerfstudio.py describes the layout.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import Any

import numpy as np

from codec.camera import Camera
from codec.errors import CodecError, InvalidError
from codec.files import opened_regular
from codec.pose import Doubles, world_to_camera
from trainer.errors import CaptureError

from .lens import Lens, check_optics
from .picturefiles import safe_path
from .points import MAX_COORDINATE_M

TRANSFORMS_NAME = "transforms.json"
CAMERA_MODELS = frozenset({"SIMPLE_PINHOLE", "PINHOLE", "SIMPLE_RADIAL", "RADIAL", "OPENCV"})

_OPENCV_FROM_OPENGL = np.array([1.0, -1.0, -1.0])
"""Signs of the camera's axes x, y, z."""


@dataclass(frozen=True, slots=True)
class Transforms:
    """A transforms.json, or one of its entries merged with what the file says for all of them."""

    path: Path
    value: Mapping[str, Any]

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
        return Transforms(self.path, {**self.value, **frame})

    def number(self, key: str, default: float | None = None) -> float:
        """The finite number under `key`. Raises CaptureError, also where it is missing and has no
        default."""
        number = self.value.get(key, default)
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
    return Entry(below, camera, lens, time, None if mask is None else safe_path(mask, given.path))


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
    width, height, fx = given.number("w"), given.number("h"), given.number("fl_x")
    if not (width.is_integer() and height.is_integer()):
        raise given.error(f"{below}: size {width:g}x{height:g} px is not whole")
    fy, cx, cy = given.number("fl_y", fx), given.number("cx"), given.number("cy")
    try:
        return Camera(str(below), int(width), int(height), fx, fy, cx, cy, pose)
    except InvalidError as error:
        raise given.error(str(error)) from error


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
