"""The two rasterisers of torch: gsplat on an NVIDIA GPU, and plain tensor operations on any device.

gsplat cuts alpha at 0.999 where recipe v1 cuts at 0.99, and beside the picture its clamp of the
Jacobian follows the principal point; everything else of the recipe is the same. It reads one number
a step back to the host: how many pairs of tile and Gaussian there are.

Plain torch has no kernel of ours; its pictures and gradients are the CPU rasteriser's but for
rounding. A step takes about 1 kB for a pixel, most of it in the loss, 0.5 kB for a Gaussian, 0.1 kB
for a pair of Gaussian and tile, and `batch_bytes`.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

import torch
from torch import Tensor

from player.render.project import LOW_PASS_PX2, TILE_PX

from .device import DeviceBackend
from .tensors import DeviceView
from .tensorstep import Raster
from .torchrender import Solids, blend, project, tensor_lists

Rasterization = Callable[..., tuple[Tensor, Tensor, dict[str, Any]]]
"""gsplat.rasterization, or what takes and gives the same."""


def gsplat_picture(
    solids: Solids, view: DeviceView, trained: int, whole: bool, rasterization: Rasterization
) -> Raster:
    """See `Rasterise`; draws all of the picture in any case."""
    pictures, _, drawn = rasterization(
        means=solids.means,
        quats=solids.quats,
        scales=solids.scales,
        opacities=solids.opacities,
        colors=solids.colours,
        viewmats=view.w2c[None],
        Ks=view.intrinsics[None],
        width=view.camera.width_px,
        height=view.camera.height_px,
        near_plane=view.near_m,
        eps2d=LOW_PASS_PX2,
        tile_size=TILE_PX,
        packed=False,
        rasterize_mode="classic",
    )
    picture = pictures[0].permute(2, 0, 1)
    if whole:
        return Raster(picture)
    centres, radii = (drawn[name][0, :trained] for name in ("means2d", "radii"))
    return Raster(picture, reached_tiles(centres, radii, view))


@torch.no_grad()
def reached_tiles(centres: Tensor, radii: Tensor, view: DeviceView) -> Tensor:
    """(tiles_y, tiles_x) bool: the tiles that boxes touch. centres: (N, 2) px; radii: (N, 2) px,
    0 where nothing shows, and the centre means nothing."""
    shows = (radii > 0).all(1)
    centres = torch.where(shows[:, None], centres, 0)
    zero = torch.zeros_like(view.tiles)
    low = ((centres - radii) / TILE_PX).floor().clamp(zero, view.tiles).long()
    high = (((centres + radii) / TILE_PX).floor() + 1).clamp(zero, view.tiles).long()
    # The corners of a box, so that running sums along both axes are 1 inside.
    columns, counts = view.tiles_x + 1, shows.float()
    marks = centres.new_zeros((view.tiles_y + 1) * columns)
    for x, y, sign in ((low, low, 1), (high, low, -1), (low, high, -1), (high, high, 1)):
        marks.index_add_(0, y[:, 1] * columns + x[:, 0], sign * counts)
    sums = marks.reshape(view.tiles_y + 1, columns).cumsum(0).cumsum(1)
    return sums[:-1, :-1] > 0.5


class CudaBackend(DeviceBackend):
    """gsplat on an NVIDIA GPU."""

    def __init__(
        self,
        dssim_weight: float,
        opacity_reg: float,
        scale_reg: float,
        rasterization: Rasterization,
        device: str = "cuda",
    ) -> None:
        """rasterization: gsplat's; device: of torch."""
        rasterise = partial(gsplat_picture, rasterization=rasterization)
        super().__init__(dssim_weight, opacity_reg, scale_reg, rasterise, device)


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
