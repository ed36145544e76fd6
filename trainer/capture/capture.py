"""The form that every capture is brought into: cameras, a frame count, pictures on demand; which
cameras are opened, and which held out.

Rule: opening a capture decodes no picture but the first of a video, yet proves that each camera has
each frame, so that a training run does not die of a missing file in its third hour.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

import numpy as np
import numpy.typing as npt

from codec.arrays import Bytes, Doubles, Floats
from codec.camera import Camera
from codec.console import listed
from codec.errors import InvalidError
from codec.stream.manifest import MAX_FPS, MIN_FPS
from trainer.errors import CaptureError

MAX_NAMED = 4
"""Cameras named in a line."""


def named(names: Sequence[str]) -> str:
    """The first of the names, and how many more there are."""
    return listed(names, MAX_NAMED)


@dataclass(frozen=True, slots=True)
class CameraChoice:
    """Which cameras of a capture to open."""

    without: tuple[str, ...] = ()
    """Names of cameras to leave out."""
    only: frozenset[str] | None = None
    """Names of the cameras to open, those that exist; None for all."""

    def keep(self, names: Collection[str], root: Path) -> list[str]:
        """The names of the cameras to open, in their order. Raises CaptureError for a camera to
        leave out that does not exist, and where none is left."""
        for name in self.without:
            if name not in names:
                raise CaptureError(
                    f"{root}: has no camera {name!r} to leave out; it has {named(sorted(names))}"
                )
        kept = [name for name in names if not self.leaves_out(name)]
        if not kept:
            asked = f"; it has {named(sorted(names))}"
            raise CaptureError(f"{root}: has none of the cameras that are asked for{asked}")
        return kept

    def leaves_out(self, name: str) -> bool:
        """Whether a camera of this name is not opened."""
        return name in self.without or (self.only is not None and name not in self.only)


ALL_CAMERAS = CameraChoice()


Picture = npt.NDArray[np.uint8]
"""(H, W, 3) RGB, C-contiguous."""

Mask = npt.NDArray[np.uint8]
"""(H, W): 1 where a picture's pixel counts, 0 where it is ignored."""

STILL_TOLERANCE = 1e-6
"""Largest change of a number of a pose or a lens at which the camera still stands still: printed
numbers are rounded."""


class PictureSource(Protocol):
    """The pictures of one camera, frame by frame.

    Not thread-safe: one thread at a time per source. Sources of different cameras are independent.
    """

    def read(self, frame: int) -> Picture:
        """The picture of a frame 0 <= frame < num_frames at full size, owned by the caller.

        Raises CaptureError when the file cannot be decoded or has another size than declared.
        """

    def close(self) -> None:
        """Frees the decoder, if there is one; the source stays usable. Idempotent."""


class MaskSource(Protocol):
    """Which pixels of one camera's pictures count. Any thread may read."""

    @property
    def is_still(self) -> bool:
        """Whether one mask holds for all frames."""

    @property
    def has_files(self) -> bool:
        """Whether there are mask files; else they are of pixels that the lens does not show."""

    @property
    def folded_share(self) -> float:
        """Share of the pixels that do not count because the terms of the lens fold them over."""

    def read(self, frame: int) -> Mask:
        """The mask of a frame at full size, owned by the caller. Raises CaptureError when the file
        cannot be read or does not fit the picture."""


@dataclass(frozen=True, slots=True, eq=False)
class InitialPoints:
    """Coloured points on the scene's surfaces at frame 0, to start the Gaussians from."""

    xyz: Floats  # (P, 3) metres, world
    rgb: Bytes  # (P, 3)

    def __post_init__(self) -> None:
        if self.xyz.ndim != 2 or self.xyz.shape[1] != 3 or self.xyz.dtype != np.float32:
            raise InvalidError(
                f"points: xyz is {self.xyz.dtype} {self.xyz.shape}, not float32 (P, 3)"
            )
        if self.rgb.shape != self.xyz.shape or self.rgb.dtype != np.uint8:
            raise InvalidError(
                f"points: rgb is {self.rgb.dtype} {self.rgb.shape}, not uint8 {self.xyz.shape}"
            )
        if not np.isfinite(self.xyz).all():
            raise InvalidError("points: a coordinate is not finite")

    def __len__(self) -> int:
        return len(self.xyz)


@dataclass(frozen=True, slots=True)
class CaptureCamera:
    """A camera of a capture and its part in training."""

    camera: Camera
    """Intrinsics at the full size of the pictures, pose, and a name that is unique in the
    capture."""
    held_out: bool
    """Kept out of training; `swings-eval` scores against its pictures."""
    masks: MaskSource | None = None
    """Which pixels count; None where all of them do."""


@dataclass(frozen=True, slots=True, eq=False)
class Capture:
    """A synchronised multi-view recording."""

    root: Path
    layout: str
    """The name of its layout, see layout.py."""
    cameras: tuple[CaptureCamera, ...]
    num_frames: int
    """Frames of every camera."""
    fps: float | None
    """Frames per second; None if no file names it."""
    points: InitialPoints | None
    """Points in the capture's folder; None when it has none."""
    near_m: float | None
    """Depth in front of which nothing of the scene stands, metres; None if the rig gives
    none."""
    far_m: float | None
    """Depth behind which nothing of the scene stands, metres; None if the rig gives none."""
    opener: Callable[[int], PictureSource]
    """Makes the source of the camera of this index; `open_images` checks the index first."""
    videos: tuple[Path, ...] = ()
    """The cameras' videos, which may have sound; empty for single pictures."""
    starts_s: tuple[float, ...] = ()
    """The time in each of them at which frame 0 of the capture is; empty if it is their first."""
    doubts: tuple[str, ...] = ()
    """What was passed over or corrected as the capture was opened, a line each."""

    def open_images(self, camera_index: int) -> PictureSource:
        """A new source of one camera's pictures; nothing is read before its first `read`."""
        if not 0 <= camera_index < len(self.cameras):
            raise InvalidError(
                f"camera {camera_index}: {self.root} has {len(self.cameras)} cameras"
            )
        return self.opener(camera_index)

    @property
    def training(self) -> tuple[int, ...]:
        """The indices of the cameras to train on."""
        return tuple(i for i, c in enumerate(self.cameras) if not c.held_out)

    @property
    def held_out(self) -> tuple[int, ...]:
        """The indices of the cameras kept out of training."""
        return tuple(i for i, c in enumerate(self.cameras) if c.held_out)

    @property
    def watching(self) -> tuple[int, ...]:
        """The indices of the cameras that show how a run does: those held out or, where none is,
        those to train on."""
        return self.held_out or self.training


MIN_TRAINING_CAMERAS = 3
"""With fewer there is no telling how deep things are."""


def check_trainable(capture: Capture) -> None:
    """Raises CaptureError where too few cameras are left to train on."""
    if len(capture.training) < MIN_TRAINING_CAMERAS:
        held_out = len(capture.held_out)
        raise CaptureError(
            f"{capture.root}: {len(capture.training)} training cameras, needs "
            f"{MIN_TRAINING_CAMERAS}" + f" beside the {held_out} held out" * (held_out > 0)
        )


def check_fps(fps: float, path: Path) -> None:
    """Raises CaptureError, naming the file that declares it, for an impossible frame rate."""
    if not MIN_FPS <= fps <= MAX_FPS:
        raise CaptureError(f"{path}: fps is {fps:g}; must be {MIN_FPS:g} to {MAX_FPS:g}")


def check_frame(frame: int, num_frames: int, name: str) -> None:
    """Raises InvalidError for a frame that the capture does not have."""
    if not 0 <= frame < num_frames:
        raise InvalidError(f"frame {frame} of camera {name}: the capture has {num_frames} frames")


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
