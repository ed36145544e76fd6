"""Which cameras of a capture are kept out of training: those that a file names, or one between the
others."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from codec.arrays import Doubles
from codec.camera import Camera
from trainer.errors import CaptureError

from .camerachoice import ALL_CAMERAS, CameraChoice

HELD_OUT_NAME = "held_out.txt"

BETWEEN_RAD = np.radians(120)
"""A camera stands between two others if it sees them at least this far apart: on a line they are
pi apart, at the end of an arc or in a corner of a grid no more than pi / 2."""

NEAREST_CAMERAS = 32
"""How many of its nearest others a camera may stand between: bounds the pairs that are looked
at."""

SAME_REACH = 1.001
"""Ratio of two distances that count as equal: poses are rounded."""


def read_held_out(
    root: Path, cameras: Sequence[Camera], choice: CameraChoice = ALL_CAMERAS
) -> frozenset[str]:
    """The names in held_out.txt, one a line, of a capture with these cameras.

    An empty file holds out none. Without a file it is the one of `camera_between`. Cameras that
    `choice` leaves out may be named. Raises CaptureError for any other name that no camera has.
    """
    path = root / HELD_OUT_NAME
    names = [camera.name for camera in cameras]
    if not path.is_file():
        return frozenset({names[camera_between(cameras)]} if names else ())
    try:
        listed = path.read_text(encoding="utf-8").split()
    except UnicodeDecodeError as error:
        raise CaptureError(f"{path}: not text: {error}") from error
    listed = [name for name in listed if not choice.leaves_out(name)]
    for name in listed:
        if name not in names:
            raise CaptureError(
                f"{path}: {name!r} is not a camera of this capture, such as {names[0]!r}"
            )
    return frozenset(listed)


def camera_between(cameras: Sequence[Camera]) -> int:
    """The index of a camera that the others surround, so that to score with it is to interpolate.

    A camera's reach is the distance to the farther of the two nearest others that it stands
    between (BETWEEN_RAD). Of the cameras whose reach is at most the median, the most central one is
    chosen: that with the least sum of distances to all others, and of equals the first. Where no
    camera stands between others, the one is chosen that comes nearest to it.
    """
    positions = np.array([camera.position for camera in cameras])
    found = [_surrounded(positions, i) for i in range(len(cameras))]
    reaches = np.array([reach for reach, _ in found])
    standing = np.isfinite(reaches)
    if standing.any():
        chosen = reaches <= SAME_REACH * np.median(reaches[standing])
    else:
        widest = np.array([angle for _, angle in found])
        chosen = widest >= widest.max() / SAME_REACH
    sums = np.array([np.linalg.norm(positions - p, axis=1).sum() for p in positions])
    central = chosen & (sums <= SAME_REACH * sums[chosen].min())
    return int(np.argmax(central))


def _surrounded(positions: Doubles, index: int) -> tuple[float, float]:
    """How far a camera has to reach for two others that it stands between, inf if there are none;
    and the widest angle at which it sees two others, radians."""
    offsets = positions - positions[index]
    distances = np.linalg.norm(offsets, axis=1)
    order = np.argsort(distances, kind="stable")
    nearest = order[distances[order] > 0][:NEAREST_CAMERAS]
    if len(nearest) < 2:
        return np.inf, 0.0
    directions = offsets[nearest] / distances[nearest, None]
    angles = np.arccos(np.clip(directions @ directions.T, -1, 1))
    farther = np.maximum(distances[nearest, None], distances[None, nearest])
    return float(np.min(farther, where=angles >= BETWEEN_RAD, initial=np.inf)), float(angles.max())
