"""Cameras by OpenCV's parameters, as calibrations write them down."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from codec.arrays import Doubles
from codec.camera import Camera
from codec.errors import InvalidError
from trainer.errors import CaptureError

from .lens import Lens, check_optics

HALF_PX = 0.5
"""OpenCV counts pixels from the middle of the first one, `Camera` from its corner."""


def camera_of_opencv(name: str, table: Mapping[str, Any], path: Path) -> tuple[Camera, Lens]:
    """The camera of size (2), matrix (3, 3), distortions (optional), rotation (a vector or (3, 3),
    world to camera) and translation (3). Raises CaptureError, naming `path`."""
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
    return camera, lens


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
