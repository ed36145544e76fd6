"""Training pictures as the loss wants them: planar floats, whole or at half the size."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from numba import prange

from codec.camera import Camera
from codec.kernel import kernel

from .loss import Workspace

Floats = npt.NDArray[np.float32]


@kernel(parallel=True)
def _planar(picture, out):  # type: ignore[no-untyped-def]
    height, width, _ = picture.shape
    unit = np.float32(1 / 255)
    for y in prange(height):
        for c in range(3):
            for x in range(width):
                out[c, y, x] = unit * np.float32(picture[y, x, c])


@kernel(parallel=True)
def _planar_half(picture, out):  # type: ignore[no-untyped-def]
    _, height, width = out.shape
    unit = np.float32(0.25 / 255)
    for y in prange(height):
        for c in range(3):
            for x in range(width):
                total = np.int32(picture[2 * y, 2 * x, c]) + np.int32(picture[2 * y, 2 * x + 1, c])
                total += np.int32(picture[2 * y + 1, 2 * x, c])
                total += np.int32(picture[2 * y + 1, 2 * x + 1, c])
                out[c, y, x] = unit * np.float32(total)


class Targets:
    """Converts pictures; keeps one target and one workspace of the loss for every size."""

    def __init__(self) -> None:
        self._held: dict[tuple[int, int], tuple[Floats, Workspace]] = {}

    def take(self, picture: npt.NDArray[np.uint8], camera: Camera) -> tuple[Floats, Workspace]:
        """The picture (H, W, 3) uint8 as (3, h, w) float32 in 0..1, where (h, w) is the camera's
        size, whole or half of the picture's; and the workspace. The next call of that size reuses
        both."""
        size = camera.height_px, camera.width_px
        if size not in self._held:
            shape = (3, *size)
            self._held[size] = np.empty(shape, np.float32), Workspace(shape)
        target, workspace = self._held[size]
        (_planar if picture.shape[:2] == size else _planar_half)(picture, target)
        return target, workspace
