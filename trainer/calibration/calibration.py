"""The calibrated cameras of a rig, as other programs write them down.

.toml, .json     OpenCV's parameters, a table for each camera, as caliscope, Pose2Sim (also of
                 Qualisys and Vicon) and anipose have them
a folder         a sparse model of COLMAP, with an image for each camera
"""

from __future__ import annotations

import json
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from codec.camera import Camera
from codec.errors import CodecError, InvalidError
from codec.files import read_bounded
from codec.pose import Doubles
from trainer.capture.colmap import cameras_of_model
from trainer.capture.lens import Lens, check_optics
from trainer.errors import CaptureError

MAX_FILE_BYTES = 1 << 24
"""Largest calibration file that is read: thousands of cameras."""

HALF_PX = 0.5
"""OpenCV counts pixels from the middle of the first one, `Camera` from its corner."""


@dataclass(frozen=True, slots=True)
class CalibratedCamera:
    """A camera of a rig and its lens."""

    camera: Camera
    lens: Lens


def read_calibration(path: Path, metres: float) -> list[CalibratedCamera]:
    """The cameras of a calibration, in its order. metres: length of its unit.

    Raises CaptureError for what is not a calibration, or a lens that is not read.
    """
    if path.is_dir():
        found = [CalibratedCamera(c, lens) for c, lens, _ in cameras_of_model(path)[1].values()]
    else:
        found = [_of_opencv(name, table, path) for name, table in _tables(path).items()]
    if not found:
        raise CaptureError(f"{path}: no camera; each needs a table with matrix, rotation, ...")
    return [replace(each, camera=_scaled(each.camera, metres)) for each in found]


def _scaled(camera: Camera, metres: float) -> Camera:
    w2c = camera.w2c.copy()
    w2c[:3, 3] *= metres
    return replace(camera, w2c=w2c)


def _tables(path: Path) -> dict[str, Mapping[str, Any]]:
    """The tables of the cameras, by the cameras' names."""
    try:
        text = read_bounded(path, MAX_FILE_BYTES).decode()
        read = json.loads(text) if path.suffix == ".json" else tomllib.loads(text)
    except CodecError as error:
        raise CaptureError(str(error)) from error
    except (ValueError, RecursionError) as error:
        raise CaptureError(f"{path}: neither TOML nor .json: {error}") from error
    if not isinstance(read, dict):
        raise CaptureError(f"{path}: not a table for each camera")
    # A table such as [metadata] is not a camera.
    cameras = {k: v for k, v in read.items() if isinstance(v, dict) and "matrix" in v}
    return {str(table.get("name", key)): table for key, table in cameras.items()}


def _of_opencv(name: str, table: Mapping[str, Any], path: Path) -> CalibratedCamera:
    where = f"{path}: camera {name}"
    if table.get("fisheye"):
        raise CaptureError(f"{where}: fisheye lenses are not read; undistort the videos first")
    width, height = _numbers(table, "size", where, (2,))
    matrix = _numbers(table, "matrix", where, (3, 3))
    bent = _numbers(table, "distortions", where, None) if "distortions" in table else np.zeros(0)
    k1, k2, p1, p2, k3, *more = [*bent.ravel().tolist(), *[0.0] * 5]
    if any(more) or matrix[0, 1]:
        raise CaptureError(f"{where}: a skew, or more than k1, k2, p1, p2, k3, is not read")
    w2c = np.eye(4)
    w2c[:3, :3] = _rotation(table, where)
    w2c[:3, 3] = _numbers(table, "translation", where, (3,))
    (fx, _, cx), (_, fy, cy), _ = matrix.tolist()
    lens = Lens(k1, k2, k3, p1, p2)
    try:
        camera = Camera(name, int(width), int(height), fx, fy, cx + HALF_PX, cy + HALF_PX, w2c)
    except InvalidError as error:
        raise CaptureError(f"{path}: {error}") from error
    check_optics(camera, lens, path)
    return CalibratedCamera(camera, lens)


def _rotation(table: Mapping[str, Any], where: str) -> Doubles:
    """(3, 3) world to camera, of a matrix or of a rotation vector, whose length is the angle."""
    given = _numbers(table, "rotation", where, None)
    if given.shape == (3, 3):
        return given
    if given.size != 3:
        raise CaptureError(f"{where}: rotation is neither rvec nor a 3x3 matrix")
    matrix: Doubles = Rotation.from_rotvec(given.ravel()).as_matrix()
    return matrix


def _numbers(
    table: Mapping[str, Any], key: str, where: str, shape: tuple[int, ...] | None
) -> Doubles:
    """The numbers of `key`, in `shape` unless that is None."""
    try:
        found = np.array(table[key], np.float64)
        found = found if shape is None else found.reshape(shape)
    except KeyError as error:
        raise CaptureError(f"{where}: has no {key}") from error
    except (TypeError, ValueError, OverflowError) as error:
        raise CaptureError(f"{where}: {key} is not numbers of the expected shape") from error
    if found.size > 64 or not np.isfinite(found).all():
        raise CaptureError(f"{where}: {key} has too many numbers, or one that is not finite")
    return found
