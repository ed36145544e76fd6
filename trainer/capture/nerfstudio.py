"""The Nerfstudio layout: a transforms.json with the poses and what it points to.

    transforms.json        fl_x, fl_y, cx, cy, w, h in pixels and the distortion k1, k2, k3, p1, p2,
                           for all or in each entry of `frames`; each entry has file_path and
                           transform_matrix, 4x4 camera to world with OpenGL axes (x right, y up,
                           z backwards). Blender's angle of view, camera_angle_x in radians, stands
                           in for fl_x, the size of the pictures for w and h, their middle for cx
                           and cy
    held_out.txt           optional, see capture.py; where it is missing, `test_filenames` in
                           transforms.json may tell the held-out cameras instead
    points.npz             optional initial points, see points.py; without it those of ply_file_path

An entry's file_path has one of these forms, the same for all entries:

    <anything>.mp4                         a video, one entry per camera, which is named like it
    <anything>/images/<camera>/<frame>.jpg see picturefiles.py; either one entry per camera, which
    <anything>/frames/<frame>/<camera>.jpg stands for all its frames on disk, or one entry for each
                                           frame to take
    any picture, with a `time`             an entry for each camera and time; entries of equal pose
                                           and lens are a camera, cam00 for the first in the file

An entry's mask_path, optional, is the mask of its picture (see masks.py), or of all frames of the
camera that the entry stands for. A camera has one in each of its entries or in none. If no entry
has one, the folder masks/ may have them, see masks.py.

An entry of a video may have `start_s`: its time, in seconds after its first frame, at which the
capture begins. Videos then need neither one length nor one rate: each frame of the capture is the
nearest in time of every video.

`fps` tells the frames per second; without it the videos do, or fps.txt beside pictures (see
picturefiles.py). Pictures of lenses that bend are straightened as they are read; fisheye models are
refused.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import replace
from pathlib import Path, PurePosixPath

from codec.camera import Camera

from .capture import (
    ALL_CAMERAS,
    HELD_OUT_NAME,
    CameraChoice,
    Capture,
    InitialPoints,
    MaskSource,
    check_fps,
    read_held_out,
)
from .dynerf import POINTS_NAME
from .masks import folder_masks, mask_source
from .picturefiles import IMAGES_NAME, folder_names, natural_order, require_files, safe_path
from .points import read_ply, read_points
from .synchrony import filmed, photographed
from .transforms import (
    TRANSFORMS_NAME,
    CameraFiles,
    Transforms,
    files_by_camera,
    is_video,
    read_entries,
)


def open_nerfstudio(root: Path, choice: CameraChoice = ALL_CAMERAS) -> Capture:
    """The chosen cameras of the capture in a folder of this layout. Raises CaptureError."""
    transforms = Transforms.read(root / TRANSFORMS_NAME)
    entries = read_entries(transforms)
    found = files_by_camera(transforms, entries, choice)
    names = sorted(found, key=natural_order)
    rig = [found[name] for name in names]
    cameras = [replace(p.entry.camera, name=name) for p, name in zip(rig, names, strict=True)]
    lenses, fps = [p.entry.lens for p in rig], _declared_fps(transforms)
    if is_video(entries[0]):
        starts_s = [p.entry.start_s for p in rig]
        videos = [p.files[0] for p in rig]
        footage = filmed(videos, cameras, lenses, transforms.path, fps, starts_s)
    else:
        footage = photographed([p.files for p in rig], cameras, lenses, transforms.path, fps)
    masks = _mask_sources(transforms.root, rig, cameras, footage.num_frames, choice)
    held_out = _held_out(transforms, cameras, rig, {entry.path for entry in entries}, choice)
    points = _read_points(transforms)
    return footage.capture(root, "nerfstudio", cameras, masks, held_out, points)


def _declared_fps(transforms: Transforms) -> float | None:
    """The frame rate that the file declares, if it does."""
    if transforms.value.get("fps") is None:
        return None
    fps = transforms.number("fps")
    check_fps(fps, transforms.path)
    return fps


def _mask_sources(
    root: Path,
    rig: Sequence[CameraFiles],
    cameras: Sequence[Camera],
    num_frames: int,
    choice: CameraChoice,
) -> list[MaskSource | None]:
    """The masks of each camera; None for a camera without any."""
    if not any(p.masks for p in rig):
        lenses, unposed = [p.entry.lens for p in rig], folder_names(root / IMAGES_NAME)
        return [*folder_masks(root, cameras, lenses, num_frames, choice, unposed)]
    require_files([p.masks for p in rig], f"a mask_path of {TRANSFORMS_NAME} names it")
    return [
        mask_source(camera, p.entry.lens, p.masks) for p, camera in zip(rig, cameras, strict=True)
    ]


def _held_out(
    transforms: Transforms,
    cameras: Sequence[Camera],
    rig: Sequence[CameraFiles],
    paths: Collection[PurePosixPath],
    choice: CameraChoice,
) -> frozenset[str]:
    """The names of the held-out cameras. paths: of all entries."""
    listed = transforms.value.get("test_filenames")
    if listed is None or (transforms.root / HELD_OUT_NAME).is_file():
        return read_held_out(transforms.root, cameras, choice)
    if not isinstance(listed, list) or not all(isinstance(name, str) for name in listed):
        raise transforms.error("test_filenames is not a list of file_path")
    tests = {safe_path(name, transforms.path) for name in listed}
    unknown = tests.difference(paths)
    if unknown:
        raise transforms.error(f"test_filenames has {min(unknown)}, which is not in `frames`")
    for camera, p in zip(cameras, rig, strict=True):
        if p.paths & tests and not p.paths <= tests:
            raise transforms.error(
                f"test_filenames has some frames of camera {camera.name}, but not "
                f"{min(p.paths - tests)}; cameras are held out whole (see {HELD_OUT_NAME})"
            )
    return frozenset(c.name for c, p in zip(cameras, rig, strict=True) if p.paths <= tests)


def _read_points(transforms: Transforms) -> InitialPoints | None:
    if (transforms.root / POINTS_NAME).is_file():
        return read_points(transforms.root / POINTS_NAME)
    name = transforms.value.get("ply_file_path")
    if name is None:
        return None
    return read_ply(transforms.root / safe_path(str(name), transforms.path))
