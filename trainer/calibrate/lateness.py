"""Whether a camera shows each moment some frames later, or earlier, than the others do."""

from __future__ import annotations

from itertools import combinations

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from codec.arrays import Doubles
from trainer.capture.capture import Capture
from trainer.pictures.scale import scaled_picture
from trainer.seed.stereo import small_camera

from .offsets import correlate, lags_of, whole_frames

MAX_FRAMES, LEAST_FRAMES = 60, 24
"""Frames that are compared, and the fewest that tell anything."""

MAX_PIXELS = 1 << 31
"""Pixels that are read at most: half a minute for 20 cameras of 1080p. Larger captures are not
looked at."""

MOST_LATE = 12
"""Frames by which a camera may be late."""

LEAST_CAMERAS = 4

BRIEF_FRAMES = 5
"""Changes are compared with their mean over this many frames: what is slower depends on where a
camera stands."""

ALIKE, SHARPER, AGREEING = 0.28, 0.1, 0.3
"""Mean correlation with the other cameras at the best lag, by how much it must exceed that at other
lags, and the median of it over all cameras. With these, of 155 trials on "basketball" with one of
its 31 cameras 1 to 9 frames off, 120 are found, one with another number of frames, and no other
camera is named."""

NOISE = 0.1
"""Mean change of a still picture, of 255."""


def late_doubts(capture: Capture, frames: range) -> list[str]:
    """A line for each camera in which everything seems to move some frames later or earlier than in
    the others. Raises CaptureError when a picture cannot be read."""
    names = [entry.camera.name for entry in capture.cameras]
    lines = []
    for name, late in zip(names, late_frames(_changes(capture, frames)), strict=False):
        if late:
            when = "later" if late > 0 else "earlier"
            lines.append(
                f"out of step: {name} seems to show everything {abs(late)} frames {when} than the "
                f"other cameras; cut its beginning to match, or use --without-cameras {name}"
            )
    return lines


def late_frames(changes: Doubles) -> list[int]:
    """By how many frames each camera is late, below 0 for early; 0 where that cannot be told.

    changes: (C, N) how much of each camera's picture changes from frame to frame. Where something
    starts, stops or hurries, it does so in all cameras at once.
    """
    count = len(changes)
    if count < LEAST_CAMERAS or changes.shape[1] < LEAST_FRAMES - 1:
        return [0] * count
    logs = np.log(changes + NOISE)
    around = np.pad(logs, ((0, 0), (BRIEF_FRAMES // 2, BRIEF_FRAMES // 2)), mode="edge")
    series = logs - sliding_window_view(around, BRIEF_FRAMES, axis=1).mean(axis=2)
    curves = {}
    for i, j in combinations(range(count), 2):
        shifts, alike = correlate(series[i], series[j])
        near = np.abs(shifts) <= MOST_LATE
        curves[i, j] = shifts[near], alike[near]
    found = lags_of(curves, count, guard=1)
    late = whole_frames(found.lags).astype(int)
    is_clear = (found.score >= ALIKE) & (found.score - found.rest >= SHARPER)
    told: list[int] = np.where(is_clear & (np.median(found.score) >= AGREEING), late, 0).tolist()
    return told


def _changes(capture: Capture, frames: range) -> Doubles:
    """What `late_frames` compares; empty if there is too much to read, or too little."""
    cameras = [entry.camera for entry in capture.cameras]
    pixels = sum(camera.width_px * camera.height_px for camera in cameras)
    count = min(len(frames), MAX_FRAMES, MAX_PIXELS // pixels)
    if count < LEAST_FRAMES or len(cameras) < LEAST_CAMERAS:
        return np.zeros((0, 0))
    changes = np.zeros((len(cameras), count - 1))
    for index, camera in enumerate(map(small_camera, cameras)):
        source = capture.open_images(index)
        try:
            before = None
            for number, frame in enumerate(frames[:count]):
                picture = scaled_picture(source.read(frame), camera).astype(np.float32)
                if before is not None:
                    changes[index, number - 1] = np.abs(picture - before).mean()
                before = picture
        finally:
            source.close()
    return changes
