"""A pinhole camera, which a capture has, a manifest carries and a renderer takes; rotations and
poses.

Quaternions are wxyz, poses OpenCV world-to-camera matrices.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt

from .arrays import Doubles
from .errors import CorruptError, InvalidError

Floating = npt.NDArray[np.floating]
"""float32 or float64."""

MAX_IMAGE_PX = 16384
"""Largest width or height accepted, in pixels: the texture limit of common GPUs."""

MAX_NAME_CHARS = 2000
"""Longest name of a camera; no text in a manifest may be longer."""


@dataclass(frozen=True, slots=True, eq=False)
class Camera:
    """Pinhole camera, OpenCV pose (x right, y down, z forward).

    Pixel positions (u, v) count columns and rows from the picture's upper left corner: the middle
    of its first pixel is (0.5, 0.5).

    Raises InvalidError at construction when the name is too long, a number is not finite, a size or
    focal length is not positive, or the pose's rotation is not orthonormal.
    """

    name: str
    width_px: int
    height_px: int
    fx_px: float
    fy_px: float
    cx_px: float
    cy_px: float
    w2c: Doubles  # (4, 4) world to camera, metres

    def __post_init__(self) -> None:
        if len(self.name) > MAX_NAME_CHARS:
            raise InvalidError(
                f"camera: a name of {len(self.name)} characters, at most {MAX_NAME_CHARS}: "
                f"{self.name[:20]!a}..."
            )
        if not (0 < self.width_px <= MAX_IMAGE_PX and 0 < self.height_px <= MAX_IMAGE_PX):
            raise InvalidError(f"camera {self.name}: size {self.width_px}x{self.height_px} px")
        if self.w2c.shape != (4, 4) or self.w2c.dtype != np.float64:
            raise InvalidError(f"camera {self.name}: the pose is not a 4x4 float64 matrix")
        intrinsics = (self.fx_px, self.fy_px, self.cx_px, self.cy_px)
        if not (np.isfinite(intrinsics).all() and np.isfinite(self.w2c).all()):
            raise InvalidError(f"camera {self.name}: a parameter is not finite")
        if not (self.fx_px > 0 and self.fy_px > 0):
            raise InvalidError(f"camera {self.name}: a focal length is not positive")
        rotation = self.w2c[:3, :3]
        if (
            np.abs(rotation @ rotation.T - np.eye(3)).max() > 1e-3
            or np.linalg.det(rotation) < 0
            or np.abs(self.w2c[3] - (0, 0, 0, 1)).max() > 1e-6
        ):
            raise InvalidError(f"camera {self.name}: the pose is not a rotation and a translation")

    @property
    def position(self) -> Doubles:
        """(3,) the camera's centre in the world, metres."""
        return -self.w2c[:3, :3].T @ self.w2c[:3, 3]

    @property
    def right(self) -> Doubles:
        """(3,) the unit direction in the world in which columns count up."""
        return self.w2c[0, :3].copy()

    @property
    def down(self) -> Doubles:
        """(3,) the unit direction in the world in which rows count up."""
        return self.w2c[1, :3].copy()

    @property
    def forward(self) -> Doubles:
        """(3,) the unit viewing direction in the world."""
        return self.w2c[2, :3].copy()

    @property
    def intrinsics(self) -> Doubles:
        """(3, 3) from the camera's coordinates to homogeneous pixels."""
        return np.array(
            [[self.fx_px, 0, self.cx_px], [0, self.fy_px, self.cy_px], [0, 0, 1]], np.float64
        )

    def project(self, points: Floating) -> tuple[Floating, Floating, Floating]:
        """(u_px, v_px, depths) of `points` (..., 3), metres, world.

        Depths are metres along the viewing axis. Where one is not above 0 the point is not in front
        of the camera, and its pixel means nothing. The pose is applied in the precision of
        `points`.
        """
        rotation = self.w2c[:3, :3].astype(points.dtype, copy=False)
        local = points @ rotation.T + self.w2c[:3, 3].astype(points.dtype, copy=False)
        x, y, depths = local[..., 0], local[..., 1], local[..., 2]
        with np.errstate(divide="ignore", over="ignore", invalid="ignore"):
            u_px = self.fx_px * x / depths + self.cx_px
            v_px = self.fy_px * y / depths + self.cy_px
        return u_px, v_px, depths

    def unproject(self, u_px: Floating, v_px: Floating, depths: Floating) -> Doubles:
        """(..., 3) the points, metres, world, that `project` maps to these pixels and depths."""
        x = (u_px - self.cx_px) / self.fx_px * depths
        y = (v_px - self.cy_px) / self.fy_px * depths
        points: Doubles = np.stack([x, y, depths], axis=-1) @ self.w2c[:3, :3] + self.position
        return points

    # Four ways to another size of the picture.

    def resized(self, width_px: int, height_px: int) -> Camera:
        """The same view on another pixel grid, whose pixels need not be as wide as high."""
        sx, sy = width_px / self.width_px, height_px / self.height_px
        return replace(
            self,
            width_px=width_px,
            height_px=height_px,
            fx_px=self.fx_px * sx,
            fy_px=self.fy_px * sy,
            cx_px=self.cx_px * sx,
            cy_px=self.cy_px * sy,
        )

    def scaled(self, scale: float) -> Camera:
        """The same view with both sides times `scale`, rounded to whole pixels, at least one."""
        return self.resized(
            max(1, round(self.width_px * scale)), max(1, round(self.height_px * scale))
        )

    def halved(self) -> Camera:
        """The camera of a picture's 2x2 means. An odd last row or column is left out, where
        `resized` would squeeze it in."""
        return replace(
            self,
            width_px=self.width_px // 2,
            height_px=self.height_px // 2,
            fx_px=self.fx_px / 2,
            fy_px=self.fy_px / 2,
            cx_px=self.cx_px / 2,
            cy_px=self.cy_px / 2,
        )

    def fitted(self, width_px: int, height_px: int) -> Camera:
        """The view inside a picture of this size: pixels keep their shape, all that showed still
        shows, and where the shapes of the pictures differ there is more to see at two sides."""
        scale = min(width_px / self.width_px, height_px / self.height_px)
        return replace(
            self,
            width_px=width_px,
            height_px=height_px,
            fx_px=self.fx_px * scale,
            fy_px=self.fy_px * scale,
            cx_px=width_px / 2 + (self.cx_px - self.width_px / 2) * scale,
            cy_px=height_px / 2 + (self.cy_px - self.height_px / 2) * scale,
        )

    def to_json(self) -> dict[str, Any]:
        return {
            "name": self.name,
            "width_px": self.width_px,
            "height_px": self.height_px,
            "fx_px": self.fx_px,
            "fy_px": self.fy_px,
            "cx_px": self.cx_px,
            "cy_px": self.cy_px,
            "w2c": [float(x) for x in self.w2c.ravel()],
        }

    @staticmethod
    def from_json(value: Mapping[str, Any]) -> Camera:
        """The camera that `to_json` described. Raises CorruptError for anything else."""

        def found(key: str, *kinds: type) -> Any:
            if type(value.get(key)) not in kinds:
                raise CorruptError(f"camera: {key} is missing or of the wrong type")
            return value[key]

        pose = found("w2c", list)
        if len(pose) != 16 or any(type(number) not in (int, float) for number in pose):
            raise CorruptError("camera: w2c is not 16 numbers")
        try:
            return Camera(
                name=found("name", str),
                width_px=found("width_px", int),
                height_px=found("height_px", int),
                fx_px=float(found("fx_px", int, float)),
                fy_px=float(found("fy_px", int, float)),
                cx_px=float(found("cx_px", int, float)),
                cy_px=float(found("cy_px", int, float)),
                w2c=np.array(pose, np.float64).reshape(4, 4),
            )
        except OverflowError as error:
            raise CorruptError("camera: a number is out of range") from error
        except InvalidError as error:
            raise CorruptError(str(error)) from error


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
