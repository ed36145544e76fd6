"""Adds to a stream what depends on all of it: the focus of its views, and its pictures."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from codec.storage.openstorage import Target, open_growing

from .manifest import Manifest, Point
from .pictures import Draw
from .poster import write_poster, write_storyboard
from .reader import StreamReader
from .writer import SHAPE

LOOKS = 16
"""Moments of the stream at which is looked what moves, at most."""

STEP_S = 0.2

LEAST_SPEED = 0.01
"""Speed from which on a Gaussian moves, in diagonals of the bounds a second: still ones flicker."""

LEAST_SHARE = 0.001
"""Share of the Gaussians that move, up to which nothing is said to."""


def finish_pictures(stream: Target, draw: Draw) -> Manifest:
    """Puts the focus into the manifest of a finished stream, and poster and storyboard beside it;
    gives the manifest."""
    reader = StreamReader(stream, max_gaussians=None)
    manifest = replace(reader.manifest, focus=focus_of(reader))
    if manifest.focus != reader.manifest.focus:
        open_growing(stream, SHAPE).finish(manifest.to_json())
    write_poster(stream, draw)
    write_storyboard(stream, draw)
    return manifest


def focus_of(reader: StreamReader) -> Point | None:
    """The middle of what moves within the bounds, metres, world; None where nothing does.

    It is the median, along each axis, of the Gaussians that go on for STEP_S and are faster than
    LEAST_SPEED.
    """
    manifest = reader.manifest
    step = max(1, round(STEP_S * manifest.fps))
    last = reader.num_frames - 1 - step
    if last < 0:
        return None
    lower, upper = np.array(manifest.bounds, np.float32)
    least_m = LEAST_SPEED * float(np.linalg.norm(upper - lower)) * step / manifest.fps
    places = []
    frames = np.unique(np.linspace(0, last, LOOKS).round().astype(int)).tolist()
    for frame in frames:
        motion = reader.motion(frame, frame + step, manifest.num_layers)
        means = motion.after.means
        moved_m = np.linalg.norm(means - motion.before.means, axis=1)
        inside = ((lower <= means) & (means <= upper)).all(axis=1)
        places.append(means[inside & ~motion.enters & (moved_m > least_m)])
    moving = np.concatenate(places)
    if len(moving) <= LEAST_SHARE * manifest.num_gs * len(frames):
        return None
    x, y, z = np.median(moving, axis=0).tolist()
    return x, y, z
