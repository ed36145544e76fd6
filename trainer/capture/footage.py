"""The pictures of all cameras: a video of each, or a picture of each frame and camera."""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass
from pathlib import Path

from codec.arrays import Longs
from codec.camera import Camera
from codec.rig import rig_depths
from trainer.pixels import opened_picture

from .capture import (
    Capture,
    CaptureCamera,
    InitialPoints,
    MaskSource,
    PictureSource,
    check_fps,
)
from .lens import Lens, straight_source
from .picturefiles import picture_source, read_fps
from .points import points_depths
from .synchrony import ShownSource, check_synchronised, shown_frames
from .video import VIDEO_SUFFIXES, VideoSource, check_video_size, probe_video


@dataclass(frozen=True, slots=True)
class Footage:
    """The pictures of all cameras."""

    num_frames: int
    fps: float | None
    open: Callable[[int], PictureSource]
    """Opens the pictures of the camera of this index."""
    videos: tuple[Path, ...] = ()
    starts_s: tuple[float, ...] = ()

    def capture(
        self,
        root: Path,
        layout: str,
        cameras: Sequence[Camera],
        masks: Sequence[MaskSource | None],
        held_out: Collection[str],
        points: InitialPoints | None,
    ) -> Capture:
        """The capture of these pictures; held_out: names of cameras."""
        depths = rig_depths(cameras, points_depths(points, cameras) if points else None)
        near_m, far_m = depths or (None, None)
        return Capture(
            root=root,
            layout=layout,
            cameras=tuple(
                CaptureCamera(camera, camera.name in held_out, mask)
                for camera, mask in zip(cameras, masks, strict=True)
            ),
            num_frames=self.num_frames,
            fps=self.fps,
            points=points,
            near_m=near_m,
            far_m=far_m,
            opener=self.open,
            videos=self.videos,
            starts_s=self.starts_s,
        )


def filmed(
    videos: Sequence[Path],
    cameras: Sequence[Camera],
    lenses: Sequence[Lens],
    declared_in: Path,
    fps: float | None = None,
    starts_s: Sequence[float | None] = (),
) -> Footage:
    """A video of each camera, whose size `declared_in` declares; fps: overrides theirs. starts_s:
    the time in each video of the capture's frame 0; without any, the videos must run in step, or
    CaptureError is raised."""
    facts = [probe_video(video) for video in videos]
    starts = [start or 0.0 for start in starts_s]
    shown: list[Longs] = []
    if any(start is not None for start in starts_s):
        fps = fps or facts[0].fps
        shown = shown_frames(videos, facts, starts, fps)
    else:
        starts = []
        check_synchronised(videos, facts)
    for video, camera, fact in zip(videos, cameras, facts, strict=True):
        check_video_size(video, fact, camera, declared_in)
    num_frames, fps = len(shown[0]) if shown else facts[0].num_frames, fps or facts[0].fps
    check_fps(fps, videos[0])

    def open_video(index: int) -> PictureSource:
        source: PictureSource = VideoSource(videos[index], cameras[index], facts[index].num_frames)
        if shown:
            source = ShownSource(source, shown[index], cameras[index].name)
        return straight_source(source, cameras[index], lenses[index])

    return Footage(num_frames, fps, open_video, tuple(videos), tuple(starts))


def photographed(
    files: Sequence[tuple[Path, ...]],
    cameras: Sequence[Camera],
    lenses: Sequence[Lens],
    declared_in: Path,
    fps: float | None = None,
) -> Footage:
    """A picture of each camera and frame, whose size `declared_in` declares; fps: overrides fps.txt
    beside it. Raises CaptureError if a first picture has another size."""
    sources = [
        picture_source(camera, lens, of_camera, declared_in)
        for camera, lens, of_camera in zip(cameras, lenses, files, strict=True)
    ]
    fps = fps or read_fps(declared_in.parent)
    return Footage(len(files[0]), fps, sources.__getitem__)


def size_of(path: Path) -> tuple[int, int]:
    """Width and height of a picture file or a video, in pixels, for layouts that declare none.
    Raises CaptureError."""
    if path.suffix.lower() in VIDEO_SUFFIXES:
        facts = probe_video(path)
        return facts.width_px, facts.height_px
    with opened_picture(path, "picture", lambda *_: None) as image:
        return image.size
