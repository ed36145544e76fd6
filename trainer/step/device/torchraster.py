"""A rasteriser in plain torch: no kernel of ours, so it runs wherever torch does.

Its pictures and gradients are the CPU rasteriser's but for rounding. A step takes about 1 kB for a
pixel, most of it in the loss, 0.5 kB for a Gaussian, 0.1 kB for a pair of Gaussian and tile, and
`batch_bytes`.
"""

from __future__ import annotations

from functools import partial

from torch import Tensor

from codec.camera import Camera
from player.render.recipe import TILE_PX
from player.render.tiles import tile_grid

from .device import DeviceBackend
from .torchblend import blend
from .torchproject import Solids, project
from .torchtiles import tensor_lists

CPU_BATCH_BYTES = 16 << 20
"""Size of a batch that stays in a CPU's caches."""

BATCH_BYTES = 512 << 20
"""Size of a batch that keeps a GPU busy."""


def torch_picture(solids: Solids, camera: Camera, near_m: float, batch_bytes: int) -> Tensor:
    """(3, H, W) float32, differentiable; see `blend` for `batch_bytes`."""
    tiles_x, tiles_y = tile_grid(camera.width_px, camera.height_px)
    drawn = project(solids, camera, near_m)
    tiles = blend(drawn.values, tensor_lists(drawn, tiles_x, tiles_y), batch_bytes)
    rows = tiles.reshape(tiles_y, tiles_x, 3, TILE_PX, TILE_PX).permute(2, 0, 3, 1, 4)
    padded = rows.reshape(3, tiles_y * TILE_PX, tiles_x * TILE_PX)
    return padded[:, : camera.height_px, : camera.width_px]


class TorchBackend(DeviceBackend):
    """Plain torch on any of its devices."""

    def __init__(
        self,
        dssim_weight: float,
        opacity_reg: float,
        scale_reg: float,
        device: str,
        batch_bytes: int | None = None,
    ) -> None:
        """device: of torch; batch_bytes: see `blend`, by default what suits the device."""
        if batch_bytes is None:
            batch_bytes = CPU_BATCH_BYTES if device == "cpu" else BATCH_BYTES
        rasterise = partial(torch_picture, batch_bytes=batch_bytes)
        super().__init__(dssim_weight, opacity_reg, scale_reg, rasterise, device)
