"""A stream beside what the held-out cameras of its capture saw."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass

import numpy as np

from codec.camera import Camera
from codec.errors import InvalidError
from codec.storage.openstorage import Target
from codec.stream import StreamReader
from codec.stream.manifest import Manifest
from codec.stream.reader import DEFAULT_MAX_GAUSSIANS
from trainer.capture.camerachoice import CameraChoice
from trainer.capture.capture import Capture
from trainer.capture.layout import open_capture
from trainer.errors import CaptureError
from trainer.pictures.framecache import FrameCache
from trainer.pictures.shot import Shot


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
