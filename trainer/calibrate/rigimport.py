"""swings-capture import: a capture of the nerfstudio layout, from videos and the calibration of
another program.

A calibration is one of these:

    .toml, .json     OpenCV's parameters, a table for each camera, as caliscope, Pose2Sim (also of
                     Qualisys and Vicon) and anipose have them
    a folder         a sparse model of COLMAP, with an image for each camera
"""

from __future__ import annotations

import json
import tomllib
from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
import tyro

from codec.camera import Camera
from codec.errors import CodecError
from codec.files import read_bounded, write_atomic
from trainer.capture.colmap import cameras_of_model
from trainer.capture.layout import open_capture
from trainer.capture.layouts import LAYOUTS
from trainer.capture.lens import Lens, camera_of_opencv
from trainer.capture.picturefiles import folder_names
from trainer.capture.transforms import TRANSFORMS_NAME
from trainer.capture.video import VIDEO_SUFFIXES
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


METRES = {"m": 1.0, "cm": 0.01, "mm": 0.001}

_OPENGL_FROM_OPENCV = np.diag([1.0, -1.0, -1.0, 1.0])
"""OpenCV's cameras have y down and z forward, nerfstudio's y up and z backwards."""


@dataclass(frozen=True)
class Import:
    """Makes a capture of a calibration and the videos of its cameras."""

    calibration: tyro.conf.Positional[Annotated[Path, tyro.conf.arg(metavar="CALIBRATION")]]
    """Calibration: a .toml or .json with OpenCV's parameters, as caliscope, Pose2Sim and anipose
    write it, or the folder of a sparse COLMAP model with an image for each camera."""
    capture: tyro.conf.Positional[Annotated[Path, tyro.conf.arg(metavar="CAPTURE")]]
    """Folder that holds the videos, and gets transforms.json."""
    videos: str = "videos"
    """Folder of the videos within CAPTURE; each is named like its camera, as cam1.mp4 for cam1."""
    unit: Literal["m", "cm", "mm"] = "m"
    """Unit of the calibration's positions. A COLMAP model has none; its unit is taken as metres."""


def import_calibration(config: Import) -> str:
    """Writes transforms.json and opens the capture that it makes; gives a line about it, and a
    warning for each doubt.

    Raises CaptureError before anything is written if cameras and videos do not match, and for a
    capture that cannot be opened.
    """
    target = config.capture / TRANSFORMS_NAME
    if target.exists():
        raise CaptureError(f"{target} exists; remove it first")
    cameras = read_calibration(config.calibration, METRES[config.unit])
    videos = _videos(config)
    names = {each.camera.name for each in cameras}
    if names != videos.keys():
        raise CaptureError(
            f"{config.calibration} has cameras {_listed(names)}, and "
            f"{config.capture / config.videos} videos {_listed(videos.keys())}: give both the same "
            "names"
        )
    frames = [transforms_entry(each, videos[each.camera.name]) for each in cameras]
    text = json.dumps({"camera_model": "OPENCV", "frames": frames}, indent=1)
    write_atomic(target, text.encode())
    try:
        capture = open_capture(config.capture)
    except CaptureError:
        target.unlink()
        raise
    doubts = [f"warning: {doubt}" for doubt in capture.doubts]
    told = f"{config.capture}: {len(cameras)} cameras, {capture.num_frames} frames"
    return "\n".join([told, *doubts])


def _videos(config: Import) -> Mapping[str, str]:
    """Paths within the capture, by the names of their cameras."""
    folder = config.capture / config.videos
    if not folder.is_dir():
        raise CaptureError(f"{folder}: no such folder; --videos names the one with the videos")
    files = (folder / name for name in sorted(folder_names(folder)))
    found = [path for path in files if path.suffix.lower() in VIDEO_SUFFIXES]
    return {path.stem: path.relative_to(config.capture).as_posix() for path in found}


def _listed(names: Any) -> str:
    return ", ".join(sorted(names)) or "none"


def transforms_entry(calibrated: CalibratedCamera, file_path: str) -> dict[str, Any]:
    """The entry of `frames` in transforms.json for one camera."""
    camera = calibrated.camera
    pose = np.linalg.inv(camera.w2c) @ _OPENGL_FROM_OPENCV
    return {
        "file_path": file_path,
        "transform_matrix": pose.tolist(),
        "w": camera.width_px,
        "h": camera.height_px,
        "fl_x": camera.fx_px,
        "fl_y": camera.fy_px,
        "cx": camera.cx_px,
        "cy": camera.cy_px,
        **asdict(calibrated.lens),
    }
