"""How a stream that is being made looks beside the files that it is made of."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from codec.arrays import Doubles
from codec.camera import Camera
from codec.pose import rotation_about
from codec.slice import Slice
from codec.splats import Splats
from codec.stream.pictures import Draw

NUM_VIEWS = 3
"""Cameras on a circle about the model, the default camera first."""

SCORE_HEIGHT_PX = 270

SAME_DB = 100.0
"""PSNR of pictures that are the same, or more alike than that."""


def cameras_around(front: Camera, centre: Doubles) -> list[Camera]:
    """NUM_VIEWS small cameras like `front` about the vertical axis through `centre`."""
    small = front.scaled(min(1.0, SCORE_HEIGHT_PX / front.height_px))
    cameras = []
    for number in range(NUM_VIEWS):
        turn = np.eye(4)
        turn[:3, :3] = rotation_about(np.array([0.0, 1.0, 0.0]), 2 * math.pi * number / NUM_VIEWS)
        turn[:3, 3] = centre - turn[:3, :3] @ centre
        w2c = small.w2c @ turn
        cameras.append(
            Camera(
                f"{small.name}{number}",
                small.width_px,
                small.height_px,
                small.fx_px,
                small.fy_px,
                small.cx_px,
                small.cy_px,
                w2c,
            )
        )
    return cameras


class ImportScore:
    """A Quality (codec.stream.draft) that compares with the files: the caller hands over that of
    each frame before it appends the frame.

    Both are drawn with harmonics of every degree that they have: degrees that the stream leaves out
    count as an error.
    """

    def __init__(self, draw: Draw, cameras: Sequence[Camera], near_m: float, every: int) -> None:
        """every: frames from a scored one to the next."""
        self._draw, self._cameras, self._near_m, self._every = draw, cameras, near_m, every
        self._sources: dict[int, Splats] = {}
        self.scores_db: list[tuple[float, ...]] = []
        """PSNR in dB of each scored frame with 1, 2, ... layers."""

    def expect(self, birth: int, source: Splats) -> None:
        """Hands over the file of a frame that is to be appended."""
        if birth % self._every == 0:
            self._sources[birth] = source

    def __call__(self, birth: int, slices: Sequence[Slice]) -> Sequence[float] | None:
        source = self._sources.pop(birth, None)
        if source is None:
            return None
        errors = np.zeros(len(slices))
        for camera in self._cameras:
            wanted = self._drawn(source, camera)
            for n, part in enumerate(slices):
                shown = part.splats.take(np.flatnonzero(part.active(birth, 1)))
                errors[n] += np.mean((self._drawn(shown, camera) - wanted) ** 2)
        least = 10 ** (-SAME_DB / 10)
        mean = np.maximum(errors / len(self._cameras), least)
        self.scores_db.append(tuple((-10 * np.log10(mean)).tolist()))
        return self.scores_db[-1]

    def _drawn(self, splats: Splats, camera: Camera) -> Doubles:
        return np.clip(self._draw(splats, camera, self._near_m), 0, 1).astype(np.float64)
