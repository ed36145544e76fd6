"""The pictures of all cameras in step: a video of each, or a picture of each frame and camera.

Frame n of a capture is frame n of every video or, where it is known when each video begins, the
nearest one in time.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from codec.arrays import Doubles, Longs
from codec.camera import Camera
from codec.rig import rig_depths
from trainer.errors import CaptureError
from trainer.pixels import opened_picture

from .capture import (
    Capture,
    CaptureCamera,
    InitialPoints,
    MaskSource,
    Picture,
    PictureSource,
    check_fps,
    check_frame,
    named,
)
from .lens import Lens, straight_source
from .picturefiles import picture_source, read_fps
from .points import points_depths
from .video import VIDEO_SUFFIXES, VideoFacts, VideoSource, check_video_size, probe_video

FPS_TOLERANCE = 1e-3
"""Largest relative difference of two constant frame rates: containers round their time base."""

MAX_APART_FRAMES = 0.5
"""Largest difference between the times of a frame in two cameras."""


def frame_times_s(facts: VideoFacts) -> Doubles:
    """(F,) the time of each frame after the first one."""
    if facts.times_s is None:
        return np.arange(facts.num_frames) / facts.fps
    return np.array(facts.times_s)


def nearest_frames(times_s: Doubles, wanted_s: Doubles) -> Longs:
    """(N,) the frames, of times (F,) in ascending order, that are nearest to the wanted times."""
    between = (times_s[1:] + times_s[:-1]) / 2
    return np.searchsorted(between, wanted_s).astype(np.int64)


def shown_frames(
    videos: Sequence[Path], facts: Sequence[VideoFacts], starts_s: Sequence[float], fps: float
) -> list[Longs]:
    """For each video its frames that show those of the capture, which begins at `starts_s` of them
    and ends with the first video. Raises CaptureError where they have no time in common."""
    times = [frame_times_s(fact) for fact in facts]
    left_s = min(t[-1] - start for t, start in zip(times, starts_s, strict=True))
    early = min(zip(starts_s, videos, strict=True))
    # Half a frame before its first picture a video still shows that one.
    if left_s < 0 or early[0] < -MAX_APART_FRAMES / fps:
        raise CaptureError(
            f"{early[1].parent}: with these starts ({early[0]:.3f} s in {early[1].name}) the "
            "videos have no time in common"
        )
    wanted_s = np.arange(int(left_s * fps + MAX_APART_FRAMES) + 1) / fps
    return [nearest_frames(t, start + wanted_s) for t, start in zip(times, starts_s, strict=True)]


class ShownSource:
    """The frames of a source that a capture shows."""

    def __init__(self, source: PictureSource, frames: Longs, name: str) -> None:
        self._source, self._frames, self._name = source, frames, name

    def read(self, frame: int) -> Picture:
        check_frame(frame, len(self._frames), self._name)
        return self._source.read(int(self._frames[frame]))

    def close(self) -> None:
        self._source.close()


def check_synchronised(videos: Sequence[Path], facts: Sequence[VideoFacts]) -> None:
    """Raises CaptureError unless all videos have as many frames, at the same times after the first
    one."""
    usual, _ = Counter(fact.num_frames for fact in facts).most_common(1)[0]
    fps = _usual_fps(facts)
    found = list(zip(videos, facts, strict=True))
    odd = [f"{path.name} has {fact.num_frames}" for path, fact in found if fact.num_frames != usual]
    if odd:
        raise CaptureError(
            f"{videos[0].parent}: the videos differ in length: {', '.join(odd)}, "
            f"the others {usual} frames; cut them to the same frames{_advice(found, fps, usual)}"
        )
    constant = [(path, fact) for path, fact in found if fact.times_s is None]
    for path, fact in constant:
        if abs(fact.fps - fps) > FPS_TOLERANCE * fps:
            other = next(p for p, f in constant if abs(f.fps - fps) <= FPS_TOLERANCE * fps)
            raise CaptureError(
                f"{path}: {fact.fps:.3f} frames per second, {other.name} {fps:.3f}; they must agree"
            )
    if len(constant) == len(found):
        return
    even = np.arange(usual) / fps
    times = np.array([even if fact.times_s is None else fact.times_s for fact in facts])
    apart = np.ptp(times, axis=0) > MAX_APART_FRAMES / fps
    if apart.any():
        frame = int(np.argmax(apart))
        early, late = int(np.argmin(times[:, frame])), int(np.argmax(times[:, frame]))
        raise CaptureError(
            f"{videos[0].parent}: the cameras do not show the same moments: frame {frame} is at "
            f"{times[early, frame]:.3f} s in {videos[early].name} and at "
            f"{times[late, frame]:.3f} s in {videos[late].name}{_advice(found, fps, usual)}"
        )


def _usual_fps(facts: Sequence[VideoFacts]) -> float:
    """The commonest rate, of the cameras with a constant one if there are any, else of what the
    others have between their gaps."""
    rates = [fact.fps for fact in facts if fact.times_s is None]
    for fact in facts if not rates else ():
        gaps = np.diff(np.array(fact.times_s))
        usual = np.abs(gaps - np.median(gaps)) < 0.5 * np.median(gaps)
        rates.append(float(1 / gaps[usual].mean()))
    return Counter(round(rate, 3) for rate in rates).most_common(1)[0][0]


def _advice(found: Sequence[tuple[Path, VideoFacts]], fps: float, usual: int) -> str:
    """The remedy for videos of variable rate; empty if there are none."""
    varying = [(path, fact.times_s) for path, fact in found if fact.times_s is not None]
    if not varying:
        return ""
    path, times_s = varying[0]
    # With frames in its gaps a video may be longer than those that have none.
    is_longer = len(varying) < len(found) and round(times_s[-1] * fps) >= usual
    cut = f"-frames:v {usual} " * is_longer
    return (
        f"; the rate of {named([p.name for p, _ in varying])} varies: make it constant with "
        f"ffmpeg -i {path.name} -vf fps={_fps_text(fps)} {cut}-c:v libx264 -crf 12 OUT.mp4"
    )


def _fps_text(fps: float) -> str:
    """The rate as ffmpeg takes it, exact for those of NTSC."""
    for scale, form in ((1.0, "{}"), (1.001, "{}000/1001")):
        whole = round(fps * scale)
        if abs(fps - whole / scale) < FPS_TOLERANCE / 2 * fps:
            return form.format(whole)
    return f"{fps:.3f}"


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
