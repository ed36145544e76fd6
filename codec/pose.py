"""Rotations and camera poses: quaternions wxyz, OpenCV world-to-camera matrices."""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

from .errors import InvalidError

Vector = npt.NDArray[np.float64]
"""A vector or a matrix of the world or of a camera."""


def look_at(position: Vector, target: Vector, up: Vector) -> Vector:
    """(4, 4) world-to-camera pose at `position` that looks at `target`. Raises InvalidError."""
    forward = target - position
    right = np.cross(forward, up)
    if not (np.linalg.norm(forward) > 1e-9 and np.linalg.norm(right) > 1e-9):
        raise InvalidError("a camera cannot look at its own place, nor straight up or down")
    forward = forward / np.linalg.norm(forward)
    right = right / np.linalg.norm(right)
    w2c = np.eye(4)
    w2c[:3, :3] = (right, np.cross(forward, right), forward)
    w2c[:3, 3] = -w2c[:3, :3] @ position
    return w2c


def rotation_about(axis: Vector, angle_rad: float) -> Vector:
    """(3, 3) rotation by `angle_rad` about the unit vector `axis`."""
    x, y, z = axis
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    turn: Vector = (
        np.eye(3) + math.sin(angle_rad) * cross + (1 - math.cos(angle_rad)) * cross @ cross
    )
    return turn


def quat_of(rotation: Vector) -> Vector:
    """(4,) unit quaternion wxyz of a (3, 3) rotation."""
    # The eigenvector of this symmetric matrix is the quaternion, without a case for each quadrant.
    (a, b, c), (d, e, f), (g, h, i) = rotation
    symmetric = np.array(
        [
            [a + e + i, h - f, c - g, d - b],
            [h - f, a - e - i, b + d, c + g],
            [c - g, b + d, e - a - i, f + h],
            [d - b, c + g, f + h, i - a - e],
        ]
    )
    quat: Vector = np.linalg.eigh(symmetric)[1][:, -1]
    return quat if quat[0] >= 0 else -quat


def rotation_of(quat: Vector) -> Vector:
    """(3, 3) rotation of a unit quaternion wxyz."""
    w, x, y, z = quat
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )


def slerp(first: Vector, last: Vector, share: float) -> Vector:
    """The unit quaternion at `share` (0..1) of the shorter turn from `first` to `last`."""
    cosine = float(first @ last)
    if cosine < 0:
        last, cosine = -last, -cosine
    angle_rad = math.acos(min(1.0, cosine))
    if angle_rad < 1e-6:
        mixed = (1 - share) * first + share * last
    else:
        mixed = math.sin((1 - share) * angle_rad) * first + math.sin(share * angle_rad) * last
    unit: Vector = mixed / np.linalg.norm(mixed)
    return unit
