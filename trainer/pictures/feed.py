"""The pictures of a capture, as training draws them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol

from codec.camera import Camera
from trainer.capture.capture import Mask

from .framecache import FrameCache
from .shot import Shot


class Pictures(Protocol):
    """Pictures of frames 0..num_frames-1 of the training cameras."""

    @property
    def num_frames(self) -> int: ...

    @property
    def cameras(self) -> Sequence[Camera]: ...

    def shot(self, camera: int, frame: int) -> Shot:
        """The picture, of the camera's size, and its mask."""
        ...

    def mask(self, camera: int, frame: int) -> Mask | None:
        """The shot's mask alone: reads no picture."""
        ...


class CapturePictures:
    """The training cameras of a cache; its first frame is frame 0."""

    def __init__(self, cache: FrameCache, indices: Sequence[int]) -> None:
        """indices: of the training cameras, in the capture."""
        self._cache, self._indices = cache, indices
        self._cameras = [cache.camera(i) for i in indices]

    @property
    def num_frames(self) -> int:
        return len(self._cache.frames)

    @property
    def cameras(self) -> Sequence[Camera]:
        return self._cameras

    def shot(self, camera: int, frame: int) -> Shot:
        return self._cache.shot(self._indices[camera], self._cache.frames[frame])

    def mask(self, camera: int, frame: int) -> Mask | None:
        return self._cache.mask(self._indices[camera], self._cache.frames[frame])

    def prefetch(self, frame: int, needed_from: int) -> None:
        """Has a frame read ahead, if there is one; frames before `needed_from` may go for it."""
        if frame < self.num_frames:
            frames = self._cache.frames
            self._cache.prefetch(self._indices, frames[frame], frames[needed_from])
