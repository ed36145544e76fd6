"""Camera paths: which camera looks at the scene in which frame.

A path is written as `default`, `camera:NAME`, `orbit`, `orbit:DEGREES` or the name of a JSON file
of key frames (keyframes.py).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from codec.camera import MAX_IMAGE_PX, Camera
from codec.errors import InvalidError
from codec.framerange import FrameRange
from codec.pose import Vector, rotation_about
from codec.stream.manifest import Manifest

from .keyframes import read_keyframes

CameraPath = Callable[[int], Camera]
"""Gives the camera of a frame."""

ENDLESS_TURN_S = 10.0
"""Duration of a turn around a stream whose end is not known, in seconds."""


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


def fitted(camera: Camera, size: Size) -> Camera:
    """`camera` on a picture of `size`: square pixels stay square, and all it showed still shows."""
    scale = min(size.width_px / camera.width_px, size.height_px / camera.height_px)
    return replace(
        camera,
        width_px=size.width_px,
        height_px=size.height_px,
        fx_px=camera.fx_px * scale,
        fy_px=camera.fy_px * scale,
        cx_px=size.width_px / 2 + (camera.cx_px - camera.width_px / 2) * scale,
        cy_px=size.height_px / 2 + (camera.cy_px - camera.height_px / 2) * scale,
    )


def turned(camera: Camera, centre: Vector, axis: Vector, angle_rad: float) -> Camera:
    """`camera` carried around the line through `centre` along the unit vector `axis`."""
    turn = rotation_about(axis, angle_rad)
    w2c = np.eye(4)
    w2c[:3, :3] = camera.w2c[:3, :3] @ turn.T
    w2c[:3, 3] = -w2c[:3, :3] @ (centre + turn @ (camera.position - centre))
    return replace(camera, w2c=w2c)


def up_of(cameras: Sequence[Camera]) -> Vector:
    """(3,) unit vector: where the top of the cameras' pictures points on average, in the world."""
    up: Vector = -np.array([camera.w2c[1, :3] for camera in cameras])
    total: Vector = up.sum(axis=0)
    if not float(np.linalg.norm(total)) > 1e-3 * len(cameras):
        total = up[0]
    unit: Vector = total / np.linalg.norm(total)
    return unit


def closest_point(cameras: Sequence[Camera]) -> Vector | None:
    """(3,) the point nearest to all viewing axes; None where they do not meet in front."""
    system: Vector = np.zeros((3, 3))
    right: Vector = np.zeros(3)
    for camera in cameras:
        across = np.eye(3) - np.outer(camera.forward, camera.forward)
        system += across
        right += across @ camera.position
    # Parallel axes meet nowhere: the smallest eigenvalue is the mean squared sine between them.
    if np.linalg.eigvalsh(system)[0] < 1e-3 * len(cameras):
        return None
    point = np.asarray(np.linalg.solve(system, right), np.float64)
    in_front = [camera.forward @ (point - camera.position) > 0 for camera in cameras]
    return point if all(in_front) else None


def scene_centre(manifest: Manifest) -> Vector:
    """(3,) what an orbit turns around: where the capture's cameras look, or the bounds' middle."""
    lower, upper = np.array(manifest.bounds, np.float64)
    point = closest_point(manifest.cameras)
    if point is not None and (lower <= point).all() and (point <= upper).all():
        return point
    middle: Vector = (lower + upper) / 2
    return middle


def orbit(manifest: Manifest, start: Camera, frames: FrameRange, arc_rad: float) -> CameraPath:
    """Around the scene's centre, from `start` at the first of `frames` and back to it at their end.

    arc_rad: 2 pi goes once around; less swings half of it to either side.
    """
    centre, axis = scene_centre(manifest), up_of(manifest.cameras)
    period = frames.count or max(1, round(ENDLESS_TURN_S * manifest.fps))
    whole = arc_rad >= 2 * math.pi - 1e-9

    def path(frame: int) -> Camera:
        phase_rad = 2 * math.pi * ((frame - frames.first) % period) / period
        angle_rad = phase_rad if whole else arc_rad / 2 * math.sin(phase_rad)
        return turned(start, centre, axis, angle_rad)

    return path


def check_path(text: str) -> None:
    """Raises InvalidError when `text` can be no camera path of any stream."""
    kind, colon, rest = text.partition(":")
    if kind == "orbit" and colon:
        _degrees(rest)
    elif not (text in ("default", "orbit") or (kind == "camera" and rest)):
        if not text.endswith(".json"):
            raise InvalidError(
                f"camera path {text!r} is none of default, camera:NAME, orbit, orbit:DEGREES "
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

    size: the pictures' size; None keeps that of the camera.
    frames: those that will be shown.
    """
    check_path(text)
    kind, _, rest = text.partition(":")
    start = manifest.camera(rest if kind == "camera" else None)
    if size is not None:
        start = fitted(start, size)
    if kind == "orbit":
        degrees = _degrees(rest) if rest else 360.0
        return orbit(manifest, start, frames, math.radians(degrees))
    if text.endswith(".json") and kind != "camera":
        return read_keyframes(Path(text), start, up_of(manifest.cameras))
    return lambda frame: start
