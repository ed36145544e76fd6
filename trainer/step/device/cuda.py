"""The rasteriser of gsplat, on an NVIDIA GPU.

gsplat cuts alpha at 0.999 where recipe v1 cuts at 0.99, and beside the picture its clamp of the
Jacobian follows the principal point; everything else of the recipe is the same. It reads one number
a step back to the host: how many pairs of tile and Gaussian there are.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

from torch import Tensor

from player.render.recipe import LOW_PASS_PX2, TILE_PX

from .device import DeviceBackend
from .deviceview import DeviceView
from .tensorloss import Raster
from .torchproject import Solids

Rasterization = Callable[..., tuple[Tensor, Tensor, dict[str, Any]]]
"""gsplat.rasterization, or what takes and gives the same."""


def gsplat_picture(
    solids: Solids, view: DeviceView, trained: int, whole: bool, rasterization: Rasterization
) -> Raster:
    """See `Rasterise`; all of the picture in any case."""
    pictures, _, _ = rasterization(
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
    return Raster(pictures[0].permute(2, 0, 1))


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
