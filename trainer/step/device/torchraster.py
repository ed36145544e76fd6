"""A rasteriser in plain torch: no kernel of ours, so it runs wherever torch does.

Its pictures and gradients are the CPU rasteriser's but for rounding. A step takes about 1 kB for a
pixel, most of it in the loss, 0.5 kB for a Gaussian, 0.1 kB for a pair of Gaussian and tile, and
`batch_bytes`.
"""

from __future__ import annotations

from functools import partial

from player.render.recipe import TILE_PX

from .device import DeviceBackend
from .deviceview import DeviceView
from .tensorloss import Raster
from .torchblend import blend
from .torchproject import Solids, project
from .torchtiles import tensor_lists

CPU_BATCH_BYTES = 16 << 20
"""Size of a batch that stays in a CPU's caches."""

BATCH_BYTES = 512 << 20
"""Size of a batch that keeps a GPU busy."""


def torch_picture(
    solids: Solids, view: DeviceView, trained: int, whole: bool, batch_bytes: int
) -> Raster:
    """See `Rasterise`; for `batch_bytes` see `blend`."""
    drawn = project(solids, view)
    count = len(solids.means)
    lists = tensor_lists(drawn, view.tiles_x, view.tiles_y, count, trained, whole)
    tiles = blend(drawn.values, lists, batch_bytes)
    rows = tiles.reshape(view.tiles_y, view.tiles_x, 3, TILE_PX, TILE_PX).permute(2, 0, 3, 1, 4)
    padded = rows.reshape(3, view.tiles_y * TILE_PX, view.tiles_x * TILE_PX)
    picture = padded[:, : view.camera.height_px, : view.camera.width_px]
    return Raster(picture, lists.active)


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
        super().__init__(dssim_weight, opacity_reg, scale_reg, rasterise, device, batch_bytes)
