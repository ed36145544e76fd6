"""Opens a capture, of whatever layout it has."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from codec.camera import Camera
from codec.storage.openstorage import Target
from trainer.errors import CaptureError
from trainer.storedfiles import by_its_name, local_folder, translated

from .capture import ALL_CAMERAS, CameraChoice, Capture, named
from .layouts import LAYOUTS, TABLE_SUFFIXES, CaptureLayout
from .picturefiles import folder_names
from .video import VIDEO_SUFFIXES, VIDEOS_NAME

SAME_POSE = 1e-4
"""Distance of two cameras over the widest one of the rig, and difference of the numbers of their
rotations, below which they have one pose."""


def open_capture(target: Target, choice: CameraChoice = ALL_CAMERAS) -> Capture:
    """The chosen cameras of the capture of a known layout in a folder or, by URL, in an object
    store.

    No picture is decoded yet but the first of a video. Raises CaptureError.
    """
    with translated():
        path = local_folder(target, TABLE_SUFFIXES)
    with by_its_name(path):
        capture = _open_folder(path, choice)
    twins = twin_doubts([entry.camera for entry in capture.cameras])
    return replace(capture, doubts=(*capture.doubts, *_fold_doubts(capture), *twins))


def _fold_doubts(capture: Capture) -> list[str]:
    shares = {c.camera.name: c.masks.folded_share for c in capture.cameras if c.masks is not None}
    folding = [f"{share:.2%} of {name}" for name, share in shares.items() if share > 0]
    if not folding:
        return []
    return [
        f"lenses that fold: {named(folding)} do not count, as the distortion folds these pixels "
        "over; calibrate with more points near the corners, or with more terms than k1"
    ]


def twin_doubts(cameras: Sequence[Camera]) -> list[str]:
    """A line for each two cameras with one pose."""
    places = np.array([camera.position for camera in cameras])
    apart = np.linalg.norm(places[:, None] - places[None], axis=2)
    turns = np.array([camera.w2c[:3, :3] for camera in cameras])
    turned = np.abs(turns[:, None] - turns[None]).max(axis=(2, 3))
    same = (apart <= SAME_POSE * apart.max()) & (turned <= SAME_POSE)
    return [
        f"one pose: {cameras[i].name} and {cameras[j].name} have the same one; one of the two is "
        "wrong, or a camera is there twice (--without-cameras leaves one out)"
        for i, j in np.argwhere(np.triu(same, 1))
    ]


def plain_videos(path: Path) -> list[Path]:
    """The videos in a folder, or in its folder of videos, where nothing gives their poses."""
    if _layout_of(folder_names(path)) is not None:
        return []
    for place in (path, path / VIDEOS_NAME):
        files = [place / name for name in folder_names(place)]
        videos = [file for file in files if file.suffix.lower() in VIDEO_SUFFIXES]
        if videos:
            return videos
    return []


def _layout_of(names: set[str] | frozenset[str]) -> CaptureLayout | None:
    """The layout of a capture whose folder holds these names."""
    return next((each for each in LAYOUTS if not names.isdisjoint(each.markers)), None)


def _open_folder(path: Path, choice: CameraChoice) -> Capture:
    if not path.exists():
        raise CaptureError(f"{path}: no such folder")
    if not path.is_dir():
        raise CaptureError(f"{path}: not a folder; name the folder that holds the capture")
    names = {entry.name for entry in path.iterdir()}
    if not names:
        raise CaptureError(f"{path}: the folder is empty")
    layout = _layout_of(names)
    if layout is not None:
        return layout.open(path, choice)
    videos = plain_videos(path)
    if videos:
        place = videos[0].parent
        raise CaptureError(
            f"{place}: {len(videos)} videos, but no poses of their cameras; make a capture of "
            f"them with swings-capture calibrate {place} CAPTURE: see 'From videos' in "
            "docs/CAPTURES.md"
        )
    *others, last = (f"{layout.contents} ({layout.title})" for layout in LAYOUTS)
    raise CaptureError(f"{path}: unknown layout; expected {', '.join(others)} or {last}")
