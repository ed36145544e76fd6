"""Whether the videos of a capture show the same moments: frame n of one camera is taken for the
moment of frame n of each other."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from trainer.errors import CaptureError

from .camerachoice import named
from .video import VideoFacts

FPS_TOLERANCE = 1e-3
"""Largest relative difference of two constant frame rates: containers round their time base."""

MAX_APART_FRAMES = 0.5
"""Largest difference between the times of a frame in two cameras."""


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
