"""Whether a camera shows each moment some frames later, or earlier, than the others do."""

from __future__ import annotations

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from codec.arrays import Doubles
from trainer.capture.capture import Capture
from trainer.pictures.scale import scaled_picture
from trainer.seed.stereo import small_camera

MAX_FRAMES, LEAST_FRAMES = 60, 24
"""Frames that are compared, and the fewest that tell anything."""

MAX_PIXELS = 1 << 31
"""Pixels that are read at most: half a minute for 20 cameras of 1080p. Larger captures are not
looked at."""

SHIFTS = range(-12, 13)
"""Frames by which a camera may be late."""

LEAST_CAMERAS = 4

BRIEF_FRAMES = 5
"""Changes are compared with their mean over this many frames: what is slower depends on where a
camera stands."""

ALIKE, CLEARER, SHARPER, AGREEING = 0.5, 0.25, 0.15, 0.4
"""Correlation with the other cameras at the best shift, by how much it must exceed that at no shift
and at other shifts, and the correlation of the others with each other. With these, of 44 trials on
"basketball" with one of its cameras shifted, 32 are found, and no camera is named wrongly."""

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
    if len(changes) < LEAST_CAMERAS or changes.shape[1] < LEAST_FRAMES - 1:
        return [0] * len(changes)
    logs = np.log(changes + NOISE)
    around = np.pad(logs, ((0, 0), (BRIEF_FRAMES // 2, BRIEF_FRAMES // 2)), mode="edge")
    series = logs - sliding_window_view(around, BRIEF_FRAMES, axis=1).mean(axis=2)
    series -= series.mean(axis=1, keepdims=True)
    series /= np.maximum(series.std(axis=1, keepdims=True), 1e-6)
    others = [np.median(np.delete(series, i, axis=0), axis=0) for i in range(len(series))]
    found = []
    for one, other in zip(series, others, strict=True):
        likeness = {shift: _likeness(one, other, shift) for shift in SHIFTS}
        best = max(likeness, key=lambda shift: likeness[shift])
        rest = max(alike for shift, alike in likeness.items() if abs(shift - best) > 1)
        is_clear = likeness[best] >= max(ALIKE, likeness[0] + CLEARER, rest + SHARPER)
        found.append(best if is_clear else 0)
    agreement = [_likeness(one, rest, 0) for one, rest in zip(series, others, strict=True)]
    return found if np.median(agreement) >= AGREEING else [0] * len(changes)


def _likeness(one: Doubles, rest: Doubles, shift: int) -> float:
    """The correlation of a camera with the others `shift` frames before; -1 if there is none."""
    a, b = (one[shift:], rest[: len(rest) - shift]) if shift >= 0 else (one[:shift], rest[-shift:])
    a, b = a - a.mean(), b - b.mean()
    size = float(np.sqrt((a * a).sum() * (b * b).sum()))
    return float((a * b).sum() / size) if size > 0 else -1.0


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
