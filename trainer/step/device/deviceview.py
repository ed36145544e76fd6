"""A camera on a device, sent once for a training."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from torch import Tensor

from codec.camera import Camera
from trainer.step.raster import View

from .crossing import Crossing


@dataclass(frozen=True, slots=True, eq=False)
class DeviceView:
    """A `View` with its matrices on the device."""

    camera: Camera
    near_m: float
    tiles_x: int
    tiles_y: int
    w2c: Tensor  # (4, 4) float32, world to camera
    intrinsics: Tensor  # (3, 3) float32
    position: Tensor  # (3,) float32, metres, world
    tiles: Tensor  # (2,) float32: tiles_x and tiles_y

    @staticmethod
    def send(view: View, crossing: Crossing) -> DeviceView:
        camera = view.camera
        tiles = np.array([view.tiles_x, view.tiles_y])
        given = camera.w2c, camera.intrinsics, camera.position, tiles
        sent = (crossing.send(np.asarray(array, np.float32)) for array in given)
        return DeviceView(camera, view.near_m, view.tiles_x, view.tiles_y, *sent)
