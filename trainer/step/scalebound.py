"""The bound of the scales of genesis: a share of a Gaussian's distance from the cameras."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from codec.arrays import Doubles, Floats, Ints
from codec.camera import Camera

from .raster import Parameters


@dataclass(frozen=True)
class CameraSpread:
    """Where the cameras of a capture stand."""

    centre: Doubles  # (3,) metres, world
    radius_m: float
    """Root mean square of their distances from the centre."""

    @staticmethod
    def of(cameras: Sequence[Camera]) -> CameraSpread:
        places = np.stack([camera.position for camera in cameras])
        centre = places.mean(axis=0)
        return CameraSpread(centre, float(np.sqrt(((places - centre) ** 2).sum(axis=1).mean())))

    def distances_m(self, means: Floats) -> Doubles:
        """(N,) root mean square of the distances of (N, 3) places from all cameras."""
        apart = means - self.centre
        distances: Doubles = np.sqrt((apart**2).sum(axis=1) + self.radius_m**2)
        return distances


def bound_scales(values: Parameters, rows: Ints, spread: CameraSpread, max_scale: float) -> None:
    """Keeps the scales of `rows` within max_scale times their distances from the cameras."""
    most = np.log(max_scale * spread.distances_m(values.means[rows])).astype(np.float32)
    values.log_scales[rows] = np.minimum(values.log_scales[rows], most[:, None])
