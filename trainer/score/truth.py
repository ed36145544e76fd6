"""How a picture of Gaussians scores against what a held-out camera saw, over all pixels and over
those that move.

In most captures almost all pixels stand still, so that a stream may score well and still blur all
that anyone looks at.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from codec.arrays import Flags, Floats
from codec.camera import Camera
from codec.errors import InvalidError
from codec.splats import Splats
from codec.storage.openstorage import Target
from codec.stream import StreamReader
from codec.stream.manifest import Manifest
from codec.stream.reader import DEFAULT_MAX_GAUSSIANS
from player.render.cpu import render_splats
from trainer.capture.capture import CameraChoice, Capture, Mask, Picture
from trainer.capture.layout import open_capture
from trainer.errors import CaptureError
from trainer.pictures.framecache import FrameCache
from trainer.pictures.scale import Shot
from trainer.step.loss import psnr_db, ssim


@dataclass(frozen=True, slots=True)
class Score:
    """How well one picture is rendered; NaN where none of its pixels counts."""

    psnr_db: float
    ssim: float


def captured(picture: Picture) -> Floats:
    """A camera's (H, W, 3) uint8 picture as floats in 0..1."""
    floats: Floats = picture.astype(np.float32) / np.float32(255)
    return floats


def displayed(splats: Splats, camera: Camera, near_m: float) -> Floats:
    """(H, W, 3) in 0..1: what a screen shows of `splats`."""
    return on_screen(render_splats(splats, camera, near_m))


def on_screen(picture: Floats) -> Floats:
    """`picture` in 0..1, rounded to the 8 bits of a screen."""
    shown: Floats = np.rint(np.clip(picture, 0, 1) * np.float32(255)) / np.float32(255)
    return shown


def score_picture(shown: Floats, truth: Floats, mask: Mask | None) -> Score:
    """Both pictures in 0..1, compared where the mask counts."""
    return Score(psnr_db(shown, truth, mask), ssim(shown, truth, mask))


def score_splats(splats: Splats, camera: Camera, shot: Shot, near_m: float) -> Score:
    """How `splats` look from `camera` against what it saw."""
    return score_picture(displayed(splats, camera, near_m), captured(shot.picture), shot.mask)


@dataclass(frozen=True, slots=True)
class ScoredCameras:
    """A stream and cameras to score it with: those held out, or those that trained it."""

    reader: StreamReader
    cameras: list[Camera]  # at the stream's size
    indices: tuple[int, ...]  # of the cameras, in the capture
    cache: FrameCache

    @property
    def training(self) -> ScoredCameras:
        """The same stream with the cameras that trained it."""
        indices = self.cache.capture.training
        return ScoredCameras(
            self.reader, [self.cache.camera(i) for i in indices], indices, self.cache
        )

    def every(self, step: int) -> range:
        """The frames 0, step, 2 step, ... of the stream. Raises InvalidError below 1."""
        if step < 1:
            raise InvalidError(f"every {step}: choose 1 or more")
        return range(0, self.reader.num_frames, step)

    def shot(self, camera: int, frame: int) -> Shot:
        """The picture of `cameras[camera]` of the stream's `frame`."""
        return self.cache.shot(self.indices[camera], self.cache.frames[frame])

    def shots(self, frame: int) -> list[Shot]:
        """All cameras' pictures of the stream's `frame`. Raises CaptureError where no pixel of one
        counts."""
        shots = [self.shot(c, frame) for c in range(len(self.cameras))]
        for camera, shot in zip(self.cameras, shots, strict=True):
            if shot.mask is not None and not shot.mask.any():
                raise CaptureError(
                    f"{self.cache.capture.root}: the mask of camera {camera.name} ignores all of "
                    f"frame {self.cache.frames[frame]}; hold out a camera that sees something"
                )
        return shots


@contextmanager
def open_held_out(
    stream: Target, capture_target: Target, max_gaussians: int | None = DEFAULT_MAX_GAUSSIANS
) -> Iterator[ScoredCameras]:
    """The stream beside its capture, until the context ends. Raises CaptureError where the capture
    is not the stream's or holds no camera out, InvalidError for a stream without a frame, and
    UnsupportedError for one of more than `max_gaussians`."""
    reader = StreamReader(stream, max_gaussians)
    manifest = reader.manifest
    # A training may have left cameras out, --without-cameras.
    known = frozenset(camera.name for camera in manifest.cameras)
    capture = open_capture(capture_target, CameraChoice(only=known))
    held_out = capture.held_out
    if not held_out:
        raise CaptureError(f"{capture.root}: no held-out camera to score with")
    if reader.num_frames == 0:
        raise InvalidError(f"{stream}: the stream has no finished segment yet")
    frames = range(manifest.capture_frame, manifest.capture_frame + reader.num_frames)
    if frames.stop > capture.num_frames:
        raise CaptureError(
            f"{capture.root} has {capture.num_frames} frames, the stream needs {frames.stop}"
        )
    cameras = stream_cameras(manifest, capture, str(stream))
    with FrameCache(capture, frames, cameras=cameras) as cache:
        yield ScoredCameras(reader, [cache.camera(i) for i in held_out], held_out, cache)


def stream_cameras(manifest: Manifest, capture: Capture, name: str) -> list[Camera]:
    """The capture's cameras at the sizes that the stream `name` was trained at.

    Raises CaptureError when a held-out camera is missing in the stream or is another one there.
    """
    known = {camera.name: camera for camera in manifest.cameras}
    for index in capture.held_out:
        camera = capture.cameras[index].camera
        if camera.name not in known:
            raise CaptureError(f"{name} has no camera {camera.name}; is this another capture?")
        trained = known[camera.name]
        scale = trained.width_px / camera.width_px
        same_pose = np.allclose(trained.w2c, camera.w2c, atol=1e-4)
        if not same_pose or abs(trained.height_px - scale * camera.height_px) > 1:
            raise CaptureError(
                f"{name}: camera {camera.name} is not the one that the stream was trained with; "
                "is this the capture of that stream?"
            )
    return [known.get(c.camera.name, c.camera) for c in capture.cameras]


MOVING = 12 / 255
"""Change from the frame before, in any channel of a pixel's 3x3 mean, above which it moves. The
mean leaves out most of a sensor's noise."""

MIN_MOVING_PX = 100
"""Fewer moving pixels than these give a picture no score: it would hang on single pixels."""


@dataclass(frozen=True, slots=True, eq=False)
class Movement:
    """The pixels of one camera that have changed since the frame before."""

    pixels: Flags  # (H, W): those that move
    counting: int
    """Pixels that count in both frames."""

    @property
    def moving(self) -> int:
        return int(self.pixels.sum())

    def busiest(self, height_px: int, width_px: int) -> tuple[slice, slice] | None:
        """Rows and columns of the box of that size with most moving pixels, in the middle of those
        that have as many; None where fewer than MIN_MOVING_PX move. The box fits into the
        picture."""
        if self.moving < MIN_MOVING_PX:
            return None
        sums = np.pad(self.pixels.cumsum(axis=0).cumsum(axis=1), ((1, 0), (1, 0)))
        inside = (
            sums[height_px:, width_px:] - sums[:-height_px, width_px:]
            - sums[height_px:, :-width_px] + sums[:-height_px, :-width_px]
        )  # fmt: skip
        best = np.argwhere(inside == inside.max())
        top, left = best[len(best) // 2]
        return slice(top, top + height_px), slice(left, left + width_px)

    def psnr_db(self, shown: Floats, truth: Floats) -> float | None:
        """PSNR over the pixels that move; None where fewer than MIN_MOVING_PX do."""
        return psnr_db(shown, truth, self.pixels) if self.moving >= MIN_MOVING_PX else None


def movement_of(before: Shot, now: Shot) -> Movement:
    """Compares two frames of one camera; both shots of the full size.

    Pixels that a mask ignores in either frame do not move, and are left out of their neighbours'
    means. Beyond the border lies the nearest pixel.
    """
    counts = np.ones(now.shape, np.int16)
    for shot in (before, now):
        if shot.mask is not None:
            counts[shot.mask == 0] = 0
    # Whole numbers, so that a change of MOVING itself is not above it by rounding.
    change = (now.picture.astype(np.int16) - before.picture) * counts[..., None]
    mean = np.abs(_sum_3x3(change)).max(axis=2) / np.maximum(_sum_3x3(counts), 1)
    return Movement((mean / 255 > MOVING) & (counts > 0), int(counts.sum()))


def _sum_3x3(values: npt.NDArray[np.int16]) -> npt.NDArray[np.int16]:
    """Sums over each pixel and its eight neighbours; values: (H, W) or (H, W, C)."""
    beyond = [(1, 1), (1, 1), (0, 0)][: values.ndim]
    padded = np.pad(values, beyond, mode="edge")
    lines = padded[:-2] + padded[1:-1] + padded[2:]
    sums: npt.NDArray[np.int16] = lines[:, :-2] + lines[:, 1:-1] + lines[:, 2:]
    return sums
