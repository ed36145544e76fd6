"""Rotations and camera poses: quaternions are wxyz, poses OpenCV world-to-camera matrices."""

from __future__ import annotations

import math

import numpy as np

from codec.arrays import Doubles

from .errors import InvalidError


def world_to_camera(rotation: Doubles, position: Doubles) -> Doubles:
    """(4, 4) pose of a camera at `position` (3,) in the world, in metres.

    rotation: (3, 3), its rows the camera's axes right, down and forward in the world.
    """
    w2c = np.eye(4)
    w2c[:3, :3] = rotation
    w2c[:3, 3] = -rotation @ position
    return w2c


def look_at(position: Doubles, target: Doubles, up: Doubles) -> Doubles:
    """(4, 4) pose of a camera at `position` that looks at `target`.

    up: where the top of the picture points, of any length but not along the view. Raises
    InvalidError.
    """
    forward = _direction(target - position, 1e-9)
    right = _direction(np.cross(forward, up), 1e-9 * float(np.linalg.norm(up)))
    return world_to_camera(np.stack([right, np.cross(forward, right), forward]), position)


def _direction(vector: Doubles, longer_than: float) -> Doubles:
    length = float(np.linalg.norm(vector))
    if not length > longer_than:
        raise InvalidError("a camera cannot look at its own position, or straight up or down")
    return vector / length


def rotation_about(axis: Doubles, angle_rad: float) -> Doubles:
    """(3, 3) rotation by `angle_rad` about the unit vector `axis`."""
    x, y, z = axis
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    turn: Doubles = (
        np.eye(3) + math.sin(angle_rad) * cross + (1 - math.cos(angle_rad)) * cross @ cross
    )
    return turn


def quat_of(rotation: Doubles) -> Doubles:
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
    quat: Doubles = np.linalg.eigh(symmetric)[1][:, -1]
    return quat if quat[0] >= 0 else -quat


def rotation_of(quat: Doubles) -> Doubles:
    """(3, 3) rotation of a unit quaternion wxyz."""
    w, x, y, z = quat
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )


def slerp(first: Doubles, last: Doubles, share: float) -> Doubles:
    """The unit quaternion at `share` (0..1) of the shorter turn from `first` to `last`."""
    cosine = float(first @ last)
    if cosine < 0:
        last, cosine = -last, -cosine
    angle_rad = math.acos(min(1.0, cosine))
    if angle_rad < 1e-6:
        mixed = (1 - share) * first + share * last
    else:
        mixed = math.sin((1 - share) * angle_rad) * first + math.sin(share * angle_rad) * last
    unit: Doubles = mixed / np.linalg.norm(mixed)
    return unit
