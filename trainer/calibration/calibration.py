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

from codec.camera import Camera
from codec.errors import CodecError
from codec.files import read_bounded
from trainer.capture.colmap import cameras_of_model
from trainer.capture.layouts import LAYOUTS
from trainer.capture.lens import Lens
from trainer.capture.opencv import camera_of_opencv
from trainer.errors import CaptureError

MAX_FILE_BYTES = 1 << 24
"""Largest calibration file that is read: thousands of cameras."""


@dataclass(frozen=True, slots=True)
class CalibratedCamera:
    """A camera of a rig and its lens."""

    camera: Camera
    lens: Lens


def read_calibration(path: Path, metres: float) -> list[CalibratedCamera]:
    """The cameras of a calibration, in its order. metres: length of its unit.

    Raises CaptureError for what is not a calibration, or a lens that is not read.
    """
    for layout in LAYOUTS:
        if path.is_file() and path.name in layout.markers:
            raise CaptureError(
                f"{path}: belongs to a capture of {layout.title} ({layout.contents}), which opens "
                f"as it is: swings-train {path.parent} STREAM"
            )
    if path.is_dir():
        found = [CalibratedCamera(c, lens) for c, lens, _ in cameras_of_model(path)[1].values()]
    else:
        found = [
            CalibratedCamera(*camera_of_opencv(name, table, path))
            for name, table in _tables(path).items()
        ]
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
