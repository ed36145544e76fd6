"""Camera paths: which camera looks at the scene in which frame.

A path is written as `default`, `camera:NAME`, `orbit`, `orbit:DEGREES` or the name of a JSON file
of key frames (keyframes.py).
"""

from __future__ import annotations

import logging
import math
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from codec.camera import MAX_IMAGE_PX, Camera
from codec.errors import InvalidError
from codec.framerange import FrameRange
from codec.rig import rig_up
from codec.stream.manifest import Manifest
from codec.stream.views import scene_centre, turned

from .keyframes import read_keyframes

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
