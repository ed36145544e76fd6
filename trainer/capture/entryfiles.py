"""The cameras that the entries of a transforms.json stand for, each with its files.

nerfstudio.py describes the forms of an entry.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path, PurePosixPath
from typing import TypeVar

import numpy as np

from trainer.errors import CaptureError

from .camerachoice import CameraChoice
from .capture import STILL_TOLERANCE
from .picturefiles import (
    FRAMES_NAME,
    IMAGES_NAME,
    check_without_gap,
    frame_number,
    pictures_by_camera,
    pictures_by_frame,
    require_files,
)
from .transforms import TRANSFORMS_NAME, Entry, Transforms
from .video import VIDEO_SUFFIXES

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
