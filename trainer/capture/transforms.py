"""The transforms.json of the Nerfstudio layout: its entries, and the cameras that they stand for,
each with its files.

nerfstudio.py describes the layout and the forms of an entry.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path, PurePosixPath
from typing import Any, TypeVar

import numpy as np

from codec.arrays import Doubles
from codec.camera import Camera, world_to_camera
from codec.errors import CodecError, InvalidError
from codec.files import opened_regular
from trainer.errors import CaptureError

from .capture import STILL_TOLERANCE, CameraChoice
from .lens import Lens, check_optics
from .picturefiles import (
    FRAMES_NAME,
    IMAGES_NAME,
    check_without_gap,
    frame_number,
    pictures_by_camera,
    pictures_by_frame,
    require_files,
    safe_path,
)
from .points import MAX_COORDINATE_M
from .synchrony import size_of
from .video import VIDEO_SUFFIXES

TRANSFORMS_NAME = "transforms.json"

START_KEY = "start_s"
"""In the entry of a video: the time in it at which frame 0 of the capture is, seconds after its
first frame. `fps` is then the capture's rate, and each of its frames the nearest of the video."""

CAMERA_MODELS = frozenset({"SIMPLE_PINHOLE", "PINHOLE", "SIMPLE_RADIAL", "RADIAL", "OPENCV"})

_OPENCV_FROM_OPENGL = np.array([1.0, -1.0, -1.0])
"""Signs of the camera's axes x, y, z."""


@dataclass(frozen=True, slots=True)
class Transforms:
    """A transforms.json, or one of its entries merged with what the file says for all of them."""

    path: Path
    value: Mapping[str, Any]
    sizes: dict[PurePosixPath, tuple[int, int]] = field(default_factory=dict)
    """Width and height of pictures whose entries give none, in pixels."""

    @classmethod
    def read(cls, path: Path) -> Transforms:
        """The file at `path`. Raises CaptureError unless it is a JSON object."""
        try:
            with opened_regular(path) as file:
                value = json.load(file)
        except CodecError as error:
            raise CaptureError(str(error)) from error
        except (ValueError, RecursionError) as error:
            raise CaptureError(f"{path}: not JSON: {error}") from error
        if not isinstance(value, dict):
            raise CaptureError(f"{path}: the top of the JSON is not an object")
        return cls(path, value)

    @property
    def root(self) -> Path:
        return self.path.parent

    def error(self, text: str) -> CaptureError:
        return CaptureError(f"{self.path}: {text}")

    def merged(self, frame: Mapping[str, Any]) -> Transforms:
        return Transforms(self.path, {**self.value, **frame}, self.sizes)

    def size_of(self, below: PurePosixPath) -> tuple[int, int]:
        """Width and height of the pictures of an entry, in pixels: of the first one of its camera,
        if its path tells which that is, else of its folder. Raises CaptureError."""
        by_frame = FRAMES_NAME in below.parts[-3:-2]
        key = PurePosixPath(below.name) if by_frame else below.parent
        if key not in self.sizes or below.suffix.lower() in VIDEO_SUFFIXES:
            self.sizes[key] = size_of(self.root / below)
        return self.sizes[key]

    def number(self, key: str, default: float | None = None) -> float:
        """The finite number under `key`. Raises CaptureError, also where it is missing and has no
        default."""
        number = self.value.get(key)
        number = default if number is None else number
        if number is None:
            raise self.error(f"lacks {key}")
        if isinstance(number, int | float) and not isinstance(number, bool):
            with suppress(OverflowError):
                if math.isfinite(number):
                    return float(number)
        raise self.error(f"{key} is {str(number)[:40]!r}, not a number")


@dataclass(frozen=True, slots=True)
class Entry:
    """An entry of `frames`."""

    path: PurePosixPath
    camera: Camera
    """Named by its file_path."""
    lens: Lens
    time: float | None
    mask: PurePosixPath | None
    start_s: float | None = None
    """See START_KEY."""


def read_entries(transforms: Transforms) -> list[Entry]:
    """The entries of `frames`. Raises CaptureError."""
    frames = transforms.value.get("frames")
    if not isinstance(frames, list) or not frames:
        raise transforms.error("`frames` is not a list of entries")
    entries: dict[PurePosixPath, Entry] = {}
    for number, frame in enumerate(frames):
        if not isinstance(frame, dict) or not isinstance(frame.get("file_path"), str):
            raise transforms.error(f"entry {number} of `frames` has no file_path")
        entry = _read_entry(transforms.merged(frame))
        if entry.path in entries:
            raise transforms.error(f"{entry.path} is listed twice")
        entries[entry.path] = entry
    return list(entries.values())


def _read_entry(given: Transforms) -> Entry:
    """One entry, merged with what the file says for all of them."""
    value, below = given.value, safe_path(given.value["file_path"], given.path)
    _check_model(given, below)
    camera = _read_camera(given, below)
    lens = Lens(**{key: given.number(key, 0.0) for key in ("k1", "k2", "k3", "p1", "p2")})
    check_optics(camera, lens, given.path)
    time = given.number("time") if "time" in value else None
    mask = value.get("mask_path")
    if not isinstance(mask, str | None):
        raise given.error(f"{below}: mask_path is {str(mask)[:40]!r}, not a path")
    start_s = given.number(START_KEY) if START_KEY in value else None
    mask_path = None if mask is None else safe_path(mask, given.path)
    return Entry(below, camera, lens, time, mask_path, start_s)


def _check_model(given: Transforms, below: PurePosixPath) -> None:
    """Raises CaptureError for a camera model that is not read."""
    model, fisheye = given.value.get("camera_model", "OPENCV"), given.value.get("is_fisheye")
    if model not in CAMERA_MODELS or fisheye:
        raise given.error(
            f"{below}: camera_model {model}{' (fisheye)' * bool(fisheye)} is not read; undistort "
            "the pictures first"
        )
    if given.number("k4", 0.0) != 0:
        raise given.error(f"{below}: distortion by k4 is not read; undistort first")


def _read_camera(given: Transforms, below: PurePosixPath) -> Camera:
    """The camera of an entry, named by its file_path."""
    pose = _read_pose(given, below)
    if any(given.value.get(side) is None for side in "wh"):
        given = given.merged(dict(zip("wh", given.size_of(below), strict=True)))
    width, height = given.number("w"), given.number("h")
    if not (width.is_integer() and height.is_integer()):
        raise given.error(f"{below}: size {width:g}x{height:g} px is not whole")
    fx = given.number("fl_x", _focal_px(given, "camera_angle_x", width))
    fy = given.number("fl_y", _focal_px(given, "camera_angle_y", height) or fx)
    cx, cy = given.number("cx", width / 2), given.number("cy", height / 2)
    try:
        return Camera(str(below), int(width), int(height), fx, fy, cx, cy, pose)
    except InvalidError as error:
        raise given.error(str(error)) from error


def _focal_px(given: Transforms, key: str, side_px: float) -> float | None:
    """The focal length of Blender's angle of view over a side; None where it is not given."""
    if given.value.get(key) is None:
        return None
    angle_rad = given.number(key)
    if not 0 < angle_rad < math.pi:
        raise given.error(f"{key} is {angle_rad:g}; must be above 0 and below pi")
    return side_px / 2 / math.tan(angle_rad / 2)


def _read_pose(given: Transforms, below: PurePosixPath) -> Doubles:
    """(4, 4) world to camera of an entry, OpenCV axes."""
    try:
        matrix = np.array(given.value.get("transform_matrix"), np.float64)
    except (ValueError, TypeError, OverflowError):
        matrix = np.zeros(0)
    if matrix.shape not in ((4, 4), (3, 4)):
        raise given.error(f"{below}: transform_matrix is not a 4x4 matrix of numbers")
    if not (np.abs(matrix) <= MAX_COORDINATE_M).all():
        raise given.error(
            f"{below}: transform_matrix has a number over 1e9 or one that is not finite"
        )
    return world_to_camera((matrix[:3, :3] * _OPENCV_FROM_OPENGL).T, matrix[:3, 3])


_Key = TypeVar("_Key", int, float)


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


def is_video(entry: Entry) -> bool:
    """Whether the entry names a video, and not a picture."""
    return entry.path.suffix.lower() in VIDEO_SUFFIXES


def files_by_camera(
    transforms: Transforms, entries: list[Entry], choice: CameraChoice
) -> dict[str, CameraFiles]:
    """Files that the entries name, by camera, those that are chosen. Raises
    CaptureError."""
    are_videos = {is_video(entry) for entry in entries}
    if are_videos == {True}:
        kept = choice.keep([entry.path.stem for entry in entries], transforms.root)
        return _videos(transforms, [entry for entry in entries if entry.path.stem in kept])
    if True in are_videos:
        raise transforms.error("some file_path are videos, some are not")
    if all(_kind(entry.path) for entry in entries):
        return _numbered(transforms, entries, choice)
    if all(entry.time is not None for entry in entries):
        return _timed(transforms, entries, choice)
    odd = next(e.path for e in entries if not _kind(e.path))
    raise transforms.error(
        f"{odd} names neither a camera nor a frame; expected "
        f"{IMAGES_NAME}/<camera>/<frame>.jpg, {FRAMES_NAME}/<frame>/<camera>.jpg, a video per "
        "camera, or a `time` in each entry"
    )


def _kind(path: PurePosixPath) -> str | None:
    """Which layout of picturefiles.py a path is in."""
    name = path.parts[-3] if len(path.parts) >= 3 else ""
    return name if name in (FRAMES_NAME, IMAGES_NAME) else None


def _videos(transforms: Transforms, entries: Sequence[Entry]) -> dict[str, CameraFiles]:
    """The cameras of entries that each name a video."""
    found: dict[str, CameraFiles] = {}
    for entry in entries:
        name, file = entry.path.stem, transforms.root / entry.path
        if name in found:
            raise transforms.error(
                f"{entry.path} and {found[name].entry.path} are both camera {name}; rename one"
            )
        if not file.is_file():
            raise CaptureError(f"{file}: is missing; {TRANSFORMS_NAME} names it")
        found[name] = _camera_files(transforms, [entry], (file,))
    return found


def _camera_files(
    transforms: Transforms, entries: Sequence[Entry], files: tuple[Path, ...]
) -> CameraFiles:
    """The camera of these entries."""
    masks, paths = _masks(transforms, entries), frozenset(entry.path for entry in entries)
    return CameraFiles(entries[0], files, masks, paths)


def _numbered(
    transforms: Transforms, entries: Sequence[Entry], choice: CameraChoice
) -> dict[str, CameraFiles]:
    """The cameras of entries whose paths tell camera and frame."""
    places = {PurePosixPath(*entry.path.parts[:-2]) for entry in entries}
    if len(places) > 1:
        named = " and ".join(sorted(map(str, places))[:2])
        raise transforms.error(f"pictures are in {named}; use one folder")
    groups = _frames_of_cameras(transforms, entries)
    groups = {name: groups[name] for name in choice.keep(groups, transforms.root)}
    if all(len(group) == 1 for group in groups.values()):
        firsts = {name: next(iter(group.values())) for name, group in groups.items()}
        return _all_on_disk(transforms, places.pop(), firsts)
    check_without_gap(next(iter(groups.values())), transforms.path)
    _check_times(transforms, groups)
    return _listed(transforms, groups)


def _frames_of_cameras(
    transforms: Transforms, entries: Sequence[Entry]
) -> dict[str, dict[int, Entry]]:
    """The entries by camera and frame number."""
    groups: dict[str, dict[int, Entry]] = {}
    for entry in entries:
        camera, frame = entry.path.parent.name, entry.path.stem
        if _kind(entry.path) == FRAMES_NAME:
            camera, frame = frame, camera
        number = frame_number(frame)
        if number is None:
            raise transforms.error(f"{entry.path}: {frame!r} does not end in a frame number")
        other = groups.setdefault(camera, {}).setdefault(number, entry)
        if other is not entry:
            raise transforms.error(
                f"{other.path} and {entry.path} are both frame {number} of camera {camera}"
            )
    return groups


def _all_on_disk(
    transforms: Transforms, place: PurePosixPath, entries: Mapping[str, Entry]
) -> dict[str, CameraFiles]:
    """The cameras of entries that each stand for all frames on disk. place: the folder of the
    pictures' folders."""
    if place.name == FRAMES_NAME:
        names = [PurePosixPath(entry.path.name) for entry in entries.values()]
        files = pictures_by_frame(transforms.root / place, names)
    else:
        files = pictures_by_camera([(transforms.root / e.path).parent for e in entries.values()])
    return {
        name: _camera_files(transforms, [entry], of_camera)
        for (name, entry), of_camera in zip(entries.items(), files, strict=True)
    }


def _timed(
    transforms: Transforms, entries: Sequence[Entry], choice: CameraChoice
) -> dict[str, CameraFiles]:
    """The cameras of entries that tell nothing but their time: one for each pose."""
    by_pose: dict[object, dict[float, Entry]] = {}
    for entry in entries:
        c, time = entry.camera, entry.time
        pose = (c.w2c.tobytes(), c.fx_px, c.fy_px, c.cx_px, c.cy_px, c.width_px, c.height_px)
        assert time is not None  # the caller made sure
        other = by_pose.setdefault((pose, entry.lens), {}).setdefault(time, entry)
        if other is not entry:
            raise transforms.error(f"{other.path} and {entry.path} have the same pose and time")
    groups = {f"cam{number:02d}": group for number, group in enumerate(by_pose.values())}
    kept = choice.keep(groups, transforms.root)
    return _listed(transforms, {name: groups[name] for name in kept})


def _check_times(transforms: Transforms, groups: Mapping[str, Mapping[int, Entry]]) -> None:
    """Raises CaptureError unless the times that entries tell rise with the frame numbers."""
    times: dict[int, float] = {}
    for number, entry in (item for group in groups.values() for item in group.items()):
        if entry.time is not None and times.setdefault(number, entry.time) != entry.time:
            raise transforms.error(
                f"{entry.path}: time {entry.time:g}, but another camera's frame {number} "
                f"has {times[number]:g}"
            )
    ordered = [times[number] for number in sorted(times)]
    if any(b <= a for a, b in pairwise(ordered)):
        raise transforms.error("the times of the entries do not rise with the frame numbers")


def _listed(
    transforms: Transforms, groups: Mapping[str, Mapping[_Key, Entry]]
) -> dict[str, CameraFiles]:
    """The cameras of entries that list every frame, by frame number or time."""
    found: dict[str, CameraFiles] = {}
    first_name, first_group = next(iter(groups.items()))
    for name, group in groups.items():
        odd = sorted(group.keys() ^ first_group.keys())
        if odd:
            lacking, having = (name, first_name) if odd[0] in first_group else (first_name, name)
            raise transforms.error(
                f"camera {lacking} lacks frame {odd[0]:g}, which camera {having} has"
            )
        ordered = [group[key] for key in sorted(group)]
        for entry in ordered:
            _check_still(transforms, ordered[0], entry)
        files = tuple(transforms.root / entry.path for entry in ordered)
        found[name] = _camera_files(transforms, ordered, files)
    require_files([camera.files for camera in found.values()])
    return found


def _masks(transforms: Transforms, entries: Sequence[Entry]) -> tuple[Path, ...]:
    """The mask files of a camera's entries: all of them have one, or none has."""
    masks = tuple(transforms.root / entry.mask for entry in entries if entry.mask is not None)
    if 0 < len(masks) < len(entries):
        lacking = next(entry.path for entry in entries if entry.mask is None)
        raise transforms.error(
            f"{lacking} has no mask_path, but other frames of its camera have one"
        )
    return masks


def _check_still(transforms: Transforms, first: Entry, entry: Entry) -> None:
    """Raises CaptureError if a camera moves or changes its lens from one entry to another."""
    a, b = first.camera, entry.camera
    same = (a.width_px, a.height_px, first.lens) == (b.width_px, b.height_px, entry.lens)
    lens = np.array([(c.fx_px, c.fy_px, c.cx_px, c.cy_px) for c in (a, b)])
    for what, changed in (
        ("moves", float(np.abs(a.w2c - b.w2c).max()) > STILL_TOLERANCE),
        ("changes its lens", not same or float(np.abs(lens[0] - lens[1]).max()) > STILL_TOLERANCE),
    ):
        if changed:
            raise transforms.error(
                f"the camera of {first.path} {what} at {entry.path}; only still cameras can be "
                "trained"
            )
