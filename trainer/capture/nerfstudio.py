"""The Nerfstudio layout: a transforms.json with the poses and what it points to.

    transforms.json        fl_x, fl_y, cx, cy, w, h in pixels and the distortion k1, k2, k3, p1, p2,
                           for all or in each entry of `frames`; each entry has file_path and
                           transform_matrix, 4x4 camera to world with OpenGL axes (x right, y up,
                           z backwards)
    held_out.txt           optional, see held_out.py; where it is missing, `test_filenames` in
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
camera that the entry stands for. A camera has one in each of its entries or in none.

`fps` tells the frames per second; without it the videos do, or fps.txt beside pictures (see
picturefiles.py). Pictures of lenses that bend are straightened as they are read; fisheye models are
refused.
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path, PurePosixPath
from typing import Any, TypeVar

import numpy as np

from codec.camera import Camera
from codec.errors import CodecError, InvalidError
from codec.files import opened_regular
from codec.pose import world_to_camera
from trainer.errors import CaptureError

from .capture import (
    STILL_TOLERANCE,
    Capture,
    CaptureCamera,
    InitialPoints,
    PictureSource,
    check_fps,
)
from .depths import rig_depths
from .dynerf import POINTS_NAME
from .held_out import HELD_OUT_NAME, read_held_out
from .lens import Lens, check_optics, straight_source
from .masks import mask_source
from .picturefiles import (
    FRAMES_NAME,
    IMAGES_NAME,
    check_without_gap,
    frame_number,
    natural_order,
    picture_source,
    pictures_by_camera,
    pictures_by_frame,
    read_fps,
    require_files,
    safe_path,
)
from .points import MAX_COORDINATE_M, points_depths, read_ply, read_points
from .video import VideoSource, check_synchronised, check_video_size, probe_video, turned_doubts

TRANSFORMS_NAME = "transforms.json"
VIDEO_SUFFIXES = frozenset({".mp4", ".mov", ".mkv", ".webm", ".avi"})
CAMERA_MODELS = frozenset({"SIMPLE_PINHOLE", "PINHOLE", "SIMPLE_RADIAL", "RADIAL", "OPENCV"})

_OPENCV_FROM_OPENGL = np.array([1.0, -1.0, -1.0])
"""Signs of the camera's axes x, y, z."""

_Key = TypeVar("_Key", int, float)


@dataclass(frozen=True, slots=True)
class Entry:
    """An entry of `frames`."""

    path: PurePosixPath
    camera: Camera
    """Named by its file_path."""
    lens: Lens
    time: float | None
    mask: PurePosixPath | None


@dataclass(frozen=True, slots=True)
class CameraFiles:
    """A camera: one of its entries, and its files."""

    entry: Entry
    files: tuple[Path, ...]
    """A video, or a picture per frame."""
    masks: tuple[Path, ...]
    """A mask per frame, one for all frames, or none."""
    paths: frozenset[PurePosixPath]
    """The file_path of each of its entries."""


def open_nerfstudio(root: Path) -> Capture:
    """The capture in a folder of this layout. Raises CaptureError."""
    path = root / TRANSFORMS_NAME
    value = _read_object(path)
    entries = _read_entries(path, value)
    found = _by_camera(root, entries)
    names = sorted(found, key=natural_order)
    rig = [found[name] for name in names]
    cameras = [replace(p.entry.camera, name=name) for p, name in zip(rig, names, strict=True)]
    fps = None if value.get("fps") is None else _number(path, value, "fps")
    if fps is not None:
        check_fps(fps, path)
    footage = (_filmed if _is_video(entries[0]) else _photographed)(path, rig, cameras, fps)
    require_files([p.masks for p in rig], f"a mask_path of {TRANSFORMS_NAME} names it")
    masks = [
        mask_source(camera, p.entry.lens, p.masks) for p, camera in zip(rig, cameras, strict=True)
    ]
    held_out = _held_out(root, value, cameras, rig)
    points = _read_points(root, value)
    depths = rig_depths(cameras, points_depths(points, cameras) if points else None)
    return Capture(
        root=root,
        layout="nerfstudio",
        cameras=tuple(
            CaptureCamera(camera, camera.name in held_out, of_camera)
            for camera, of_camera in zip(cameras, masks, strict=True)
        ),
        num_frames=footage.num_frames,
        fps=footage.fps,
        points=points,
        near_m=depths[0] if depths else None,
        far_m=depths[1] if depths else None,
        opener=footage.open,
        doubts=footage.doubts,
    )


def _is_video(entry: Entry) -> bool:
    return entry.path.suffix.lower() in VIDEO_SUFFIXES


def _by_camera(root: Path, entries: list[Entry]) -> dict[str, CameraFiles]:
    """What the entries name, by camera."""
    path = root / TRANSFORMS_NAME
    are_videos = {_is_video(entry) for entry in entries}
    if are_videos == {True}:
        return _videos(root, entries)
    if True in are_videos:
        raise CaptureError(f"{path}: some file_path are videos, some are not")
    if all(_kind(entry.path) for entry in entries):
        return _numbered(root, entries)
    if all(entry.time is not None for entry in entries):
        return _timed(root, entries)
    odd = next(e.path for e in entries if not _kind(e.path))
    raise CaptureError(
        f"{path}: {odd} names neither a camera nor a frame; expected "
        f"{IMAGES_NAME}/<camera>/<frame>.jpg, {FRAMES_NAME}/<frame>/<camera>.jpg, a video per "
        "camera, or a `time` in each entry"
    )


@dataclass(frozen=True, slots=True)
class _Footage:
    """The pictures of all cameras."""

    num_frames: int
    fps: float | None
    open: Callable[[int], PictureSource]
    """Of the camera of this index."""
    doubts: tuple[str, ...] = ()


def _filmed(
    path: Path, rig: list[CameraFiles], cameras: list[Camera], fps: float | None
) -> _Footage:
    """A video of each camera."""
    videos = [p.files[0] for p in rig]
    facts = [probe_video(video) for video in videos]
    check_synchronised(videos, facts)
    for video, camera, fact in zip(videos, cameras, facts, strict=True):
        check_video_size(video, fact, camera, path)
    num_frames, fps = facts[0].num_frames, fps or facts[0].fps
    check_fps(fps, videos[0])

    def open_video(index: int) -> PictureSource:
        source = VideoSource(videos[index], cameras[index], num_frames)
        return straight_source(source, cameras[index], rig[index].entry.lens)

    return _Footage(num_frames, fps, open_video, tuple(turned_doubts(videos, facts)))


def _photographed(
    path: Path, rig: list[CameraFiles], cameras: list[Camera], fps: float | None
) -> _Footage:
    """A picture of each frame and camera."""
    sources = [
        picture_source(camera, p.entry.lens, p.files, path)
        for p, camera in zip(rig, cameras, strict=True)
    ]
    return _Footage(len(rig[0].files), fps or read_fps(path.parent), sources.__getitem__)


def _read_object(path: Path) -> dict[str, Any]:
    try:
        with opened_regular(path) as file:
            value = json.load(file)
    except CodecError as error:
        raise CaptureError(str(error)) from error
    except (ValueError, RecursionError) as error:
        raise CaptureError(f"{path}: not JSON: {error}") from error
    if not isinstance(value, dict):
        raise CaptureError(f"{path}: the top of the JSON is not an object")
    return value


def _read_entries(path: Path, value: dict[str, Any]) -> list[Entry]:
    frames = value.get("frames")
    if not isinstance(frames, list) or not frames:
        raise CaptureError(f"{path}: `frames` is not a list of entries")
    entries: dict[PurePosixPath, Entry] = {}
    for number, frame in enumerate(frames):
        if not isinstance(frame, dict) or not isinstance(frame.get("file_path"), str):
            raise CaptureError(f"{path}: entry {number} of `frames` has no file_path")
        entry = _read_entry(path, {**value, **frame})
        if entry.path in entries:
            raise CaptureError(f"{path}: {entry.path} is listed twice")
        entries[entry.path] = entry
    return list(entries.values())


def _read_entry(path: Path, value: Mapping[str, Any]) -> Entry:
    """One entry, merged with what the file says for all of them."""
    below = safe_path(value["file_path"], path)
    model = value.get("camera_model", "OPENCV")
    if model not in CAMERA_MODELS or value.get("is_fisheye"):
        raise CaptureError(
            f"{path}: {below}: camera_model {model}{' (fisheye)' * bool(value.get('is_fisheye'))} "
            "is not read; undistort the pictures first"
        )
    if _number(path, value, "k4", 0.0) != 0:
        raise CaptureError(f"{path}: {below}: distortion by k4 is not read; undistort first")
    try:
        matrix = np.array(value.get("transform_matrix"), np.float64)
    except (ValueError, TypeError, OverflowError):
        matrix = np.zeros(0)
    if matrix.shape not in ((4, 4), (3, 4)):
        raise CaptureError(f"{path}: {below}: transform_matrix is not a 4x4 matrix of numbers")
    if not (np.abs(matrix) <= MAX_COORDINATE_M).all():
        raise CaptureError(
            f"{path}: {below}: transform_matrix has a number over 1e9 or one that is not finite"
        )
    w2c = world_to_camera((matrix[:3, :3] * _OPENCV_FROM_OPENGL).T, matrix[:3, 3])
    width, height = _number(path, value, "w"), _number(path, value, "h")
    if not (width.is_integer() and height.is_integer()):
        raise CaptureError(f"{path}: {below}: size {width:g}x{height:g} px is not whole")
    fx = _number(path, value, "fl_x")
    try:
        camera = Camera(
            name=str(below),
            width_px=int(width),
            height_px=int(height),
            fx_px=fx,
            fy_px=_number(path, value, "fl_y", fx),
            cx_px=_number(path, value, "cx"),
            cy_px=_number(path, value, "cy"),
            w2c=w2c,
        )
    except InvalidError as error:
        raise CaptureError(f"{path}: {error}") from error
    lens = Lens(**{key: _number(path, value, key, 0.0) for key in ("k1", "k2", "k3", "p1", "p2")})
    check_optics(camera, lens, path)
    time = _number(path, value, "time") if "time" in value else None
    mask = value.get("mask_path")
    if not isinstance(mask, str | None):
        raise CaptureError(f"{path}: {below}: mask_path is {str(mask)[:40]!r}, not a path")
    return Entry(below, camera, lens, time, None if mask is None else safe_path(mask, path))


def _number(path: Path, value: Mapping[str, Any], key: str, default: float | None = None) -> float:
    number = value.get(key, default)
    if number is None:
        raise CaptureError(f"{path}: lacks {key}")
    if isinstance(number, int | float) and not isinstance(number, bool):
        with suppress(OverflowError):
            if math.isfinite(number):
                return float(number)
    raise CaptureError(f"{path}: {key} is {str(number)[:40]!r}, not a number")


def _kind(path: PurePosixPath) -> str | None:
    """Which layout of picturefiles.py a path is in."""
    name = path.parts[-3] if len(path.parts) >= 3 else ""
    return name if name in (FRAMES_NAME, IMAGES_NAME) else None


def _videos(root: Path, entries: Sequence[Entry]) -> dict[str, CameraFiles]:
    found: dict[str, CameraFiles] = {}
    for entry in entries:
        file = root / entry.path
        if entry.path.stem in found:
            raise CaptureError(
                f"{root / TRANSFORMS_NAME}: {entry.path} and {found[entry.path.stem].entry.path} "
                f"are both camera {entry.path.stem}; rename one"
            )
        if not file.is_file():
            raise CaptureError(f"{file}: is missing; {TRANSFORMS_NAME} names it")
        found[entry.path.stem] = CameraFiles(
            entry, (file,), _masks(root, [entry]), frozenset({entry.path})
        )
    return found


def _numbered(root: Path, entries: Sequence[Entry]) -> dict[str, CameraFiles]:
    """The cameras of entries whose paths tell camera and frame."""
    path = root / TRANSFORMS_NAME
    places = {PurePosixPath(*entry.path.parts[:-2]) for entry in entries}
    if len(places) > 1:
        raise CaptureError(
            f"{path}: pictures are in {' and '.join(sorted(map(str, places))[:2])}; use one folder"
        )
    (place,) = places
    groups: dict[str, dict[int, Entry]] = {}
    for entry in entries:
        camera, frame = entry.path.parent.name, entry.path.stem
        if place.name == FRAMES_NAME:
            camera, frame = frame, camera
        number = frame_number(frame)
        if number is None:
            raise CaptureError(f"{path}: {entry.path}: {frame!r} does not end in a frame number")
        group = groups.setdefault(camera, {})
        if number in group:
            raise CaptureError(
                f"{path}: {group[number].path} and {entry.path} are both frame {number} of "
                f"camera {camera}"
            )
        group[number] = entry
    if all(len(group) == 1 for group in groups.values()):
        firsts = [next(iter(group.values())) for group in groups.values()]
        if place.name == FRAMES_NAME:
            files = pictures_by_frame(root / place, [PurePosixPath(e.path.name) for e in firsts])
        else:
            files = pictures_by_camera([(root / e.path).parent for e in firsts])
        return {
            name: CameraFiles(entry, of_camera, _masks(root, [entry]), frozenset({entry.path}))
            for name, entry, of_camera in zip(groups, firsts, files, strict=True)
        }
    check_without_gap(next(iter(groups.values())), path)
    _check_times(path, groups)
    return _listed(root, groups)


def _timed(root: Path, entries: Sequence[Entry]) -> dict[str, CameraFiles]:
    """The cameras of entries that tell nothing but their time: one for each pose."""
    path = root / TRANSFORMS_NAME
    by_pose: dict[object, dict[float, Entry]] = {}
    for entry in entries:
        c = entry.camera
        key = (c.w2c.tobytes(), c.fx_px, c.fy_px, c.cx_px, c.cy_px, c.width_px, c.height_px)
        group = by_pose.setdefault((key, entry.lens), {})
        assert entry.time is not None  # the caller made sure
        if entry.time in group:
            raise CaptureError(
                f"{path}: {group[entry.time].path} and {entry.path} have the same pose and time"
            )
        group[entry.time] = entry
    return _listed(
        root, {f"cam{number:02d}": group for number, group in enumerate(by_pose.values())}
    )


def _check_times(path: Path, groups: Mapping[str, Mapping[int, Entry]]) -> None:
    """Raises CaptureError unless the times that entries tell rise with the frame numbers."""
    times: dict[int, float] = {}
    for number, entry in (item for group in groups.values() for item in group.items()):
        if entry.time is not None and times.setdefault(number, entry.time) != entry.time:
            raise CaptureError(
                f"{path}: {entry.path}: time {entry.time:g}, but another camera's frame {number} "
                f"has {times[number]:g}"
            )
    ordered = [times[number] for number in sorted(times)]
    if any(b <= a for a, b in pairwise(ordered)):
        raise CaptureError(f"{path}: the times of the entries do not rise with the frame numbers")


def _listed(root: Path, groups: Mapping[str, Mapping[_Key, Entry]]) -> dict[str, CameraFiles]:
    """The cameras of entries that list every frame, by frame number or time."""
    path = root / TRANSFORMS_NAME
    found: dict[str, CameraFiles] = {}
    first_name, first_group = next(iter(groups.items()))
    for name, group in groups.items():
        odd = sorted(group.keys() ^ first_group.keys())
        if odd:
            lacking, having = (name, first_name) if odd[0] in first_group else (first_name, name)
            raise CaptureError(
                f"{path}: camera {lacking} lacks frame {odd[0]:g}, which camera {having} has"
            )
        ordered = [group[key] for key in sorted(group)]
        for entry in ordered:
            _check_still(path, ordered[0], entry)
        found[name] = CameraFiles(
            ordered[0],
            tuple(root / entry.path for entry in ordered),
            _masks(root, ordered),
            frozenset(entry.path for entry in ordered),
        )
    require_files([camera.files for camera in found.values()])
    return found


def _masks(root: Path, entries: Sequence[Entry]) -> tuple[Path, ...]:
    """The mask files of a camera's entries: all of them have one, or none has."""
    masks = tuple(root / entry.mask for entry in entries if entry.mask is not None)
    if 0 < len(masks) < len(entries):
        lacking = next(entry.path for entry in entries if entry.mask is None)
        raise CaptureError(
            f"{root / TRANSFORMS_NAME}: {lacking} has no mask_path, but other frames of its camera "
            "have one"
        )
    return masks


def _check_still(path: Path, first: Entry, entry: Entry) -> None:
    a, b = first.camera, entry.camera
    same = (a.width_px, a.height_px, first.lens) == (b.width_px, b.height_px, entry.lens)
    lens = np.array([(c.fx_px, c.fy_px, c.cx_px, c.cy_px) for c in (a, b)])
    for what, changed in (
        ("moves", float(np.abs(a.w2c - b.w2c).max()) > STILL_TOLERANCE),
        ("changes its lens", not same or float(np.abs(lens[0] - lens[1]).max()) > STILL_TOLERANCE),
    ):
        if changed:
            raise CaptureError(
                f"{path}: the camera of {first.path} {what} at {entry.path}; "
                "only still cameras can be trained"
            )


def _held_out(
    root: Path, value: Mapping[str, Any], cameras: Sequence[Camera], rig: Sequence[CameraFiles]
) -> frozenset[str]:
    path, listed = root / TRANSFORMS_NAME, value.get("test_filenames")
    if listed is None or (root / HELD_OUT_NAME).is_file():
        return read_held_out(root, cameras)
    if not isinstance(listed, list) or not all(isinstance(name, str) for name in listed):
        raise CaptureError(f"{path}: test_filenames is not a list of file_path")
    tests = {safe_path(name, path) for name in listed}
    unknown = tests - frozenset().union(*(p.paths for p in rig))
    if unknown:
        raise CaptureError(f"{path}: test_filenames has {min(unknown)}, which is not in `frames`")
    held_out = set()
    for camera, p in zip(cameras, rig, strict=True):
        if p.paths <= tests:
            held_out.add(camera.name)
        elif p.paths & tests:
            raise CaptureError(
                f"{path}: test_filenames has some frames of camera {camera.name}, but not "
                f"{min(p.paths - tests)}; cameras are held out whole (see {HELD_OUT_NAME})"
            )
    return frozenset(held_out)


def _read_points(root: Path, value: Mapping[str, Any]) -> InitialPoints | None:
    if (root / POINTS_NAME).is_file():
        return read_points(root / POINTS_NAME)
    name = value.get("ply_file_path")
    if name is None:
        return None
    return read_ply(root / safe_path(str(name), root / TRANSFORMS_NAME))
