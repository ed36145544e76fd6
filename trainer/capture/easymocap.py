"""The EasyMocap layout: OpenCV's parameters in two files, and pictures or videos.

    intri.yml, extri.yml   OpenCV's YAML: K_<camera> 3x3 pixels and dist_<camera>; Rot_<camera> 3x3
                           or R_<camera>, a rotation vector, and T_<camera>, world to camera
    and the pictures, the first of these that exists:
    images/<camera>/<frame>.jpg   see picturefiles.py
    videos/<camera>.mp4           also .mov, .mkv, .webm and .avi
    held_out.txt           optional, see capture.py
    points.npz             optional initial points, see points.py
    fps.txt                optional, for pictures, see picturefiles.py
    masks/                 optional, see masks.py

A camera has the size of its first picture. Pictures of lenses that bend are straightened as they
are read.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from codec.errors import CodecError
from codec.files import read_bounded
from trainer.errors import CaptureError

from .capture import ALL_CAMERAS, CameraChoice, Capture, read_held_out
from .dynerf import POINTS_NAME
from .lens import camera_of_opencv
from .masks import folder_masks
from .picturefiles import IMAGES_NAME, folder_names, natural_order, pictures_by_camera
from .points import read_points
from .synchrony import filmed, photographed, size_of
from .video import VIDEO_SUFFIXES, VIDEOS_NAME

INTRINSICS_NAME, EXTRINSICS_NAME = "intri.yml", "extri.yml"
MAX_FILE_BYTES = 1 << 24
"""Largest calibration file that is read: thousands of cameras."""

_MATRIX = re.compile(
    r"^(\w+?)_(.+?): *!!opencv-matrix"
    r"\s+rows: *(\d+)\s+cols: *(\d+)\s+dt: *\w+\s+data: *\[([^\]]*)\]",
    re.MULTILINE,
)
_KEYS = {
    "K": "matrix",
    "dist": "distortions",
    "R": "rotation",
    "Rot": "rotation",
    "T": "translation",
}
"""What `camera_of_opencv` calls the matrices."""


def open_easymocap(root: Path, choice: CameraChoice = ALL_CAMERAS) -> Capture:
    """The chosen cameras of the capture in a folder of this layout. Raises CaptureError."""
    path = root / INTRINSICS_NAME
    tables = _read_tables(path)
    for name, more in _read_tables(root / EXTRINSICS_NAME).items():
        tables.setdefault(name, {}).update(more)
    names = sorted(choice.keep(tables, root), key=natural_order)
    are_pictures = (root / IMAGES_NAME).is_dir()
    files = _pictures(root, names) if are_pictures else _videos(root, names)
    rig = [
        camera_of_opencv(name, tables[name] | {"size": size_of(of_camera[0])}, path)
        for name, of_camera in zip(names, files, strict=True)
    ]
    cameras, lenses = [camera for camera, _ in rig], [lens for _, lens in rig]
    if are_pictures:
        footage = photographed(files, cameras, lenses, path)
    else:
        footage = filmed([of_camera[0] for of_camera in files], cameras, lenses, path)
    masks = folder_masks(root, cameras, lenses, footage.num_frames, choice)
    held_out = read_held_out(root, cameras, choice)
    points = read_points(root / POINTS_NAME) if (root / POINTS_NAME).is_file() else None
    return footage.capture(root, "easymocap", cameras, masks, held_out, points)


def _read_tables(path: Path) -> dict[str, dict[str, Any]]:
    """The matrices of a file for each camera, under the keys of `camera_of_opencv`."""
    try:
        text = read_bounded(path, MAX_FILE_BYTES).decode()
    except CodecError as error:
        raise CaptureError(
            f"{error}; {INTRINSICS_NAME} and {EXTRINSICS_NAME} go together"
        ) from error
    except UnicodeDecodeError as error:
        raise CaptureError(f"{path}: not text: {error}") from error
    tables: dict[str, dict[str, Any]] = {}
    for kind, name, rows, columns, data in _MATRIX.findall(text):
        words = data.replace(",", " ").split()
        if kind not in _KEYS:
            continue
        if len(words) != int(rows) * int(columns):
            raise CaptureError(
                f"{path}: {kind}_{name} has {len(words)} numbers, not {rows}x{columns}"
            )
        # Rot_ says the same as R_, and comes after it; either will do.
        table = tables.setdefault(name, {})
        table[_KEYS[kind]] = [
            words[i : i + int(columns)] for i in range(0, len(words), int(columns))
        ]
    if not tables:
        raise CaptureError(f"{path}: has no matrix of a camera, such as K_01: !!opencv-matrix")
    return tables


def _pictures(root: Path, names: Sequence[str]) -> list[tuple[Path, ...]]:
    return pictures_by_camera([root / IMAGES_NAME / name for name in names])


def _videos(root: Path, names: Sequence[str]) -> list[tuple[Path, ...]]:
    folder = root / VIDEOS_NAME
    files = [folder / name for name in sorted(folder_names(folder))]
    videos = {file.stem: file for file in files if file.suffix.lower() in VIDEO_SUFFIXES}
    for name in names:
        if name not in videos:
            raise CaptureError(
                f"{folder / name}.mp4: is missing, and so is {IMAGES_NAME}/; each camera of "
                f"{INTRINSICS_NAME} needs pictures or a video"
            )
    return [(videos[name],) for name in names]
