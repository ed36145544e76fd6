"""What was filmed: a video or a folder of pictures of each camera, before its pose is known."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from codec.arrays import Doubles
from codec.camera import Camera
from trainer.capture.capture import PictureSource, named
from trainer.capture.picturefiles import (
    PICTURE_SUFFIXES,
    FileSource,
    folder_names,
    natural_order,
    pictures_by_camera,
    read_fps,
)
from trainer.capture.synchrony import frame_times_s, nearest_frames, size_of
from trainer.capture.video import VIDEO_SUFFIXES, VideoSource, probe_video
from trainer.errors import CaptureError

NOMINAL_FPS = 30.0
"""Rate of pictures whose rate no file gives."""


@dataclass(frozen=True, slots=True, eq=False)
class Take:
    """What one camera filmed."""

    name: str
    files: tuple[Path, ...]
    """A video, or a picture for each frame."""
    width_px: int
    height_px: int
    times_s: Doubles  # (F,) of each frame after the first one
    fps: float | None
    """Frames per second; None where no file gives it."""

    @property
    def is_video(self) -> bool:
        return self.files[0].suffix.lower() in VIDEO_SUFFIXES

    def open(self) -> PictureSource:
        """Its pictures, frame by frame."""
        side = float(max(self.width_px, self.height_px))
        size = self.width_px, self.height_px
        camera = Camera(self.name, *size, side, side, size[0] / 2, size[1] / 2, np.eye(4))
        if self.is_video:
            return VideoSource(self.files[0], camera, len(self.times_s))
        return FileSource(camera, self.files, self.files[0])

    def nearest_frame(self, time_s: float) -> int:
        """The frame nearest to a time after the first one."""
        return int(nearest_frames(self.times_s, np.array([time_s]))[0])


def find_takes(given: Sequence[Path], without: Sequence[str] = ()) -> list[Take]:
    """The takes of videos, folders of pictures, or one folder of either, in natural order of their
    names. Raises CaptureError."""
    paths = [path for one in given for path in _paths(one)]
    names = [path.stem if _is_video(path) else path.name for path in paths]
    for name in without:
        if name not in names:
            raise CaptureError(f"{name!r} is no camera to leave out; there are {named(names)}")
    chosen: dict[str, Path] = {}
    for name, path in zip(names, paths, strict=True):
        if name in chosen:
            raise CaptureError(
                f"{chosen[name]} and {path} are both camera {name}; rename one of them"
            )
        if name not in without:
            chosen[name] = path
    if len(chosen) < 2:
        raise CaptureError(
            f"{given[0]}: {len(chosen)} videos or folders of pictures; give one for each camera"
        )
    takes = [_take(name, chosen[name]) for name in sorted(chosen, key=natural_order)]
    if len({take.is_video for take in takes}) > 1:
        odd = next(take for take in takes if not take.is_video)
        raise CaptureError(f"{odd.files[0].parent}: pictures beside videos; give one or the other")
    return takes


def _is_video(path: Path) -> bool:
    return path.suffix.lower() in VIDEO_SUFFIXES


def _paths(given: Path) -> list[Path]:
    """The video or the folder of pictures that is given, or all of them in a folder."""
    if not given.exists():
        raise CaptureError(f"{given}: no such file or folder")
    if given.is_file():
        if not _is_video(given):
            raise CaptureError(f"{given}: not a video; videos end in {', '.join(VIDEO_SUFFIXES)}")
        return [given]
    inside = [given / name for name in folder_names(given)]
    videos = [path for path in inside if _is_video(path)]
    if videos:
        return videos
    if any(path.suffix.lower() in PICTURE_SUFFIXES for path in inside):
        return [given]
    return [path for path in inside if path.is_dir() and _has_pictures(path)]


def _has_pictures(folder: Path) -> bool:
    return any(Path(name).suffix.lower() in PICTURE_SUFFIXES for name in folder_names(folder))


def _take(name: str, path: Path) -> Take:
    if _is_video(path):
        facts = probe_video(path)
        times_s = frame_times_s(facts)
        return Take(name, (path,), facts.width_px, facts.height_px, times_s, facts.fps)
    files = pictures_by_camera([path])[0]
    fps = read_fps(path) or read_fps(path.parent)
    width_px, height_px = size_of(files[0])
    times_s = np.arange(len(files)) / (fps or NOMINAL_FPS)
    return Take(name, files, width_px, height_px, times_s, fps)
