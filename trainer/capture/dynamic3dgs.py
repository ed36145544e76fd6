"""The Dynamic 3D Gaussians layout (PanopticSports): JPEG files and a JSON of poses per split.

    train_meta.json, test_meta.json   w, h; per frame t and camera c: k[t][c] 3x3 pixels,
                                      w2c[t][c] 4x4 OpenCV, fn[t][c] path below ims/, cam_id[t][c]
    ims/<camera>/<frame>.jpg
    init_pt_cld.npz                   optional initial points, see points.py
    fps.txt                           optional, see picturefiles.py; the layout itself has no rate
    masks/                            optional, see masks.py

    held_out.txt                      optional, see capture.py; where it is missing, the cameras of
                                      test_meta.json are held out

The layout could describe moving cameras; this project cannot use them, so they are refused rather
than frozen at their first pose.
"""

from __future__ import annotations

import json
import os
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path, PurePosixPath
from typing import Any

import numpy as np

from codec.arrays import Doubles
from codec.camera import Camera
from codec.errors import InvalidError
from codec.rig import rig_depths
from trainer.errors import CaptureError

from .capture import (
    ALL_CAMERAS,
    HELD_OUT_NAME,
    STILL_TOLERANCE,
    CameraChoice,
    Capture,
    CaptureCamera,
    PictureSource,
    read_held_out,
)
from .lens import Lens, check_optics
from .masks import folder_masks
from .picturefiles import FileSource, read_fps
from .points import read_points

META_NAMES = ("train_meta.json", "test_meta.json")
POINTS_NAMES = ("init_pt_cld.npz", "derived_init_points_frame0.npz")
"""Files of initial points, the data set's own first."""


@dataclass(frozen=True, slots=True)
class Meta:
    """One of the two JSON files, checked."""

    path: Path
    num_frames: int
    cameras: tuple[Camera, ...]
    names: tuple[tuple[str, ...], ...]
    """Paths below ims/, by camera and frame."""


def open_dynamic3dgs(root: Path, choice: CameraChoice = ALL_CAMERAS) -> Capture:
    """The chosen cameras of the capture in a folder of this layout. Raises CaptureError."""
    if not (root / META_NAMES[0]).is_file():
        raise CaptureError(f"{root / META_NAMES[0]}: is missing; it names the cameras to train on")
    metas = [read_meta(root / name) for name in META_NAMES if (root / name).is_file()]
    if metas[0].num_frames != metas[-1].num_frames:
        raise CaptureError(
            f"{root}: {META_NAMES[0]} has {metas[0].num_frames} frames, "
            f"{META_NAMES[1]} {metas[1].num_frames}; they must agree"
        )
    found: dict[str, tuple[CaptureCamera, tuple[str, ...], Path]] = {}
    for is_held_out, meta in zip((False, True), metas, strict=False):
        for camera, names in zip(meta.cameras, meta.names, strict=True):
            if camera.name in found:
                raise CaptureError(f"{meta.path}: camera {camera.name} is listed twice")
            found[camera.name] = CaptureCamera(camera, is_held_out), names, meta.path
    kept = choice.keep(found, root)
    ordered = [found[name] for name in sorted(kept, key=lambda name: (len(name), name))]
    cameras = tuple(camera for camera, _, _ in ordered)
    if len(metas) == 1 or (root / HELD_OUT_NAME).is_file():
        held_out = read_held_out(root, [c.camera for c in cameras], choice)
        cameras = tuple(replace(c, held_out=c.camera.name in held_out) for c in cameras)
    masks = folder_masks(
        root, [c.camera for c in cameras], [Lens()] * len(cameras), metas[0].num_frames, choice
    )
    cameras = tuple(replace(c, masks=mask) for c, mask in zip(cameras, masks, strict=True))
    sources = _sources(root, [(c.camera, names, path) for c, names, path in ordered])
    depths = rig_depths([c.camera for c in cameras])
    points = next((root / name for name in POINTS_NAMES if (root / name).is_file()), None)

    def open_images(camera_index: int) -> PictureSource:
        return sources[camera_index]

    return Capture(
        root=root,
        layout="dynamic3dgs",
        cameras=cameras,
        num_frames=metas[0].num_frames,
        fps=read_fps(root),
        points=read_points(points) if points else None,
        near_m=depths[0] if depths else None,
        far_m=depths[1] if depths else None,
        opener=open_images,
    )


def read_meta(path: Path) -> Meta:
    """The cameras and file names of one JSON file. Raises CaptureError."""
    try:
        value = json.loads(path.read_bytes())
    except (ValueError, RecursionError) as error:
        raise CaptureError(f"{path}: not JSON: {error}") from error
    if not isinstance(value, dict):
        raise CaptureError(f"{path}: the top of the JSON is not an object")
    lacking = [key for key in ("w", "h", "k", "w2c", "fn", "cam_id") if key not in value]
    if lacking:
        raise CaptureError(f"{path}: lacks {', '.join(lacking)}")
    width_px, height_px = value["w"], value["h"]
    if not (isinstance(width_px, int) and isinstance(height_px, int)):
        raise CaptureError(f"{path}: w and h are not whole numbers of pixels")
    intrinsics = _table(path, value, "k", (3, 3))
    poses = _table(path, value, "w2c", (4, 4))
    num_frames, num_cameras = poses.shape[:2]
    ids, names = value["cam_id"], value["fn"]
    for key, table in (("cam_id", ids), ("fn", names), ("k", value["k"])):
        if not _is_grid(table, num_frames, num_cameras):
            raise CaptureError(
                f"{path}: {key} is not a {num_frames} x {num_cameras} table like w2c"
            )
    for frame, row in enumerate(ids):
        if row != ids[0]:
            raise CaptureError(f"{path}: cam_id of frame {frame} differs from that of frame 0")
    return Meta(
        path=path,
        num_frames=num_frames,
        cameras=tuple(
            _still_camera(
                path,
                "cam" + str(ids[0][c]).zfill(2),
                width_px,
                height_px,
                intrinsics[:, c],
                poses[:, c],
            )
            for c in range(num_cameras)
        ),
        names=tuple(tuple(str(row[c]) for row in names) for c in range(num_cameras)),
    )


def _table(path: Path, value: dict[str, Any], key: str, shape: tuple[int, int]) -> Doubles:
    try:
        table = np.array(value[key], np.float64)
    except (ValueError, TypeError, OverflowError) as error:
        raise CaptureError(
            f"{path}: {key} is not a table of {shape[0]}x{shape[1]} matrices"
        ) from error
    if table.ndim != 4 or table.shape[2:] != shape or 0 in table.shape:
        raise CaptureError(
            f"{path}: {key} has shape {table.shape}, not (frames, cameras, {shape[0]}, {shape[1]})"
        )
    return table


def _is_grid(table: object, rows: int, columns: int) -> bool:
    return (
        isinstance(table, list)
        and len(table) == rows
        and all(isinstance(row, list) and len(row) == columns for row in table)
    )


def _still_camera(
    path: Path,
    name: str,
    width_px: int,
    height_px: int,
    intrinsics: Doubles,  # (T, 3, 3)
    poses: Doubles,  # (T, 4, 4)
) -> Camera:
    for what, rows in (("moves", poses), ("changes its lens", intrinsics)):
        changed = np.abs(rows - rows[:1]).max(axis=(1, 2)) > STILL_TOLERANCE
        if changed.any():
            raise CaptureError(
                f"{path}: {name} {what} at frame {int(np.argmax(changed))}; "
                "only still cameras can be trained"
            )
    k = intrinsics[0]
    if abs(k[0, 1]) > 1e-3 * abs(k[0, 0]):
        raise CaptureError(
            f"{path}: {name} has skewed pixels (k[0][1] = {k[0, 1]:g}); undistort first"
        )
    try:
        camera = Camera(
            name=name,
            width_px=width_px,
            height_px=height_px,
            fx_px=float(k[0, 0]),
            fy_px=float(k[1, 1]),
            cx_px=float(k[0, 2]),
            cy_px=float(k[1, 2]),
            w2c=poses[0].copy(),
        )
    except InvalidError as error:
        raise CaptureError(f"{path}: {error}") from error
    check_optics(camera, Lens(), path)
    return camera


def _sources(
    root: Path, cameras: Sequence[tuple[Camera, Sequence[str], Path]]
) -> tuple[FileSource, ...]:
    """A source for each camera with its paths below ims/ and the file that names them. Each folder
    is listed once to see that every file is there."""
    folder = root / "ims"
    if not folder.is_dir():
        raise CaptureError(f"{folder}: is missing; the pictures belong there")
    listed: dict[Path, frozenset[str]] = {}
    sources = []
    for camera, names, declared_in in cameras:
        files = []
        for frame, name in enumerate(names):
            parts = PurePosixPath(name.replace("\\", "/"))
            if parts.is_absolute() or ".." in parts.parts or not parts.parts:
                raise CaptureError(
                    f"{root}: {camera.name} frame {frame}: {name!r} is not a path below ims/"
                )
            file = folder / parts
            if file.parent not in listed:
                listed[file.parent] = _list_files(file.parent)
            if file.name not in listed[file.parent]:
                raise CaptureError(f"{file}: is missing; {camera.name} lacks frame {frame}")
            files.append(file)
        source = FileSource(camera, tuple(files), declared_in)
        source.check_header()
        sources.append(source)
    return tuple(sources)


def _list_files(folder: Path) -> frozenset[str]:
    try:
        with os.scandir(folder) as entries:
            return frozenset(entry.name for entry in entries)
    except (FileNotFoundError, NotADirectoryError):
        return frozenset()
