"""Colours, loss and regularisers of a step in tensors."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import torch
from torch import Tensor

from codec.splats import SH_C0
from player.render.recipe import SH_C1, SH_C2, SH_C3, TILE_PX
from trainer.step.loss import C1, C2, IGNORED, RADIUS_PX, TAPS

from .crossing import Crossing
from .deviceview import DeviceView
from .packedrows import parts_of
from .torchproject import Solids


@dataclass(frozen=True, slots=True)
class Raster:
    """A rendered picture."""

    picture: Tensor  # (3, H, W), differentiable
    active: Tensor | None = None  # (tiles_y, tiles_x) bool: tiles that matter; None: all


Rasterise = Callable[[Solids, DeviceView, int, bool], Raster]
"""Solids as a camera sees them. The number is that of the solids, the first ones, that are trained:
others need no gradient. The flag is whether all of the picture is compared: else only tiles that
the trained ones reach need be drawn, and their neighbours."""


def _blurred(planes: Tensor, taps: Tensor) -> Tensor:
    """(M, 3, H, W), blurred by the window of SSIM, zero beyond the border."""
    rows = taps.reshape(1, 1, 1, -1).expand(3, 1, 1, -1)
    columns = taps.reshape(1, 1, -1, 1).expand(3, 1, -1, 1)
    planes = torch.nn.functional.conv2d(planes, rows, padding=(0, RADIUS_PX), groups=3)
    blurred: Tensor = torch.nn.functional.conv2d(planes, columns, padding=(RADIUS_PX, 0), groups=3)
    return blurred


def dissimilarity_map(pred: Tensor, target: Tensor, taps: Tensor) -> Tensor:
    """(3, H, W): 1 - SSIM of two pictures."""
    with torch.no_grad():
        mu_t, tt = _blurred(torch.stack([target, target * target]), taps)
    mu_p, pp, pt = _blurred(torch.stack([pred, pred * pred, pred * target]), taps)
    var_p, var_t, cov = pp - mu_p**2, tt - mu_t**2, pt - mu_p * mu_t
    ssim = ((2 * mu_p * mu_t + C1) * (2 * cov + C2)) / (
        (mu_p**2 + mu_t**2 + C1) * (var_p + var_t + C2)
    )
    dissimilarity: Tensor = 1 - ssim
    return dissimilarity


def seen_colours(means: Tensor, sh: Tensor, position: Tensor) -> Tensor:
    """(N, 3) of recipe v1, of any SH degree."""
    colours = 0.5 + SH_C0 * sh[:, 0]
    if sh.shape[1] >= 4:
        x, y, z = torch.nn.functional.normalize(means - position, dim=1).unsqueeze(-1).unbind(1)
        colours = colours + SH_C1 * (z * sh[:, 2] - y * sh[:, 1] - x * sh[:, 3])
    if sh.shape[1] >= 9:
        higher = torch.cat(_higher_harmonics(x, y, z)[: sh.shape[1] - 4], 1)
        colours = colours + (higher[:, :, None] * sh[:, 4:]).sum(1)
    return colours.clamp(min=0)


def _higher_harmonics(x: Tensor, y: Tensor, z: Tensor) -> list[Tensor]:
    """(N, 1) each of degree 2 and 3, of unit vectors; see player.render.colours."""
    xx, yy, zz = x * x, y * y, z * z
    return [
        SH_C2[0] * x * y,
        -SH_C2[0] * y * z,
        SH_C2[1] * (2 * zz - xx - yy),
        -SH_C2[0] * x * z,
        SH_C2[2] * (xx - yy),
        -SH_C3[0] * y * (3 * xx - yy),
        SH_C3[1] * x * y * z,
        -SH_C3[2] * y * (4 * zz - xx - yy),
        SH_C3[3] * z * (2 * zz - 3 * xx - 3 * yy),
        -SH_C3[2] * x * (4 * zz - xx - yy),
        SH_C3[4] * z * (xx - yy),
        -SH_C3[0] * x * (xx - 3 * yy),
    ]


@dataclass(frozen=True, slots=True)
class Compared:
    """The loss of a picture."""

    photometric: Tensor  # (); where only some tiles matter, see `Loss`
    total: Tensor  # () with the regularisers: what is differentiated
    picture: Tensor  # (3, H, W) as rendered, before the camera's correction
    is_whole: bool  # whether the gradient by the correction is that of all of the picture


class TensorLoss:
    """Renders and compares."""

    def __init__(
        self,
        dssim_weight: float,
        opacity_reg: float,
        scale_reg: float,
        rasterise: Rasterise,
        crossing: Crossing,
    ) -> None:
        self._dssim_weight = dssim_weight
        self._opacity_reg, self._scale_reg = opacity_reg, scale_reg
        self.rasterise = rasterise
        self._taps = crossing.send(TAPS)

    def render(self, packed: Tensor, view: DeviceView, trained: int, whole: bool = True) -> Raster:
        """Rows (M, D), see `packedrows`, as `view` sees them; for the others see `Rasterise`."""
        means, log_scales, quats, logits, sh = parts_of(packed)
        solids = Solids(
            means,
            torch.nn.functional.normalize(quats, dim=1),
            log_scales.exp(),
            torch.sigmoid(logits),
            seen_colours(means, sh, view.position),
        )
        return self.rasterise(solids, view, trained, whole)

    def compare(
        self,
        packed: Tensor,
        view: DeviceView,
        target: Tensor,
        counts: Tensor | None,
        correction: Tensor,
        trained: int,
        whole: bool,
    ) -> Compared:
        """The rows `packed` (M, D) seen by `view`, against `target` (3, H, W) in 0..1. For
        `trained` and `whole` see `Rasterise`.

        counts: (H, W) bool, where a pixel counts; None: all do. correction: (6,) gain and bias of
        the camera's colours.
        """
        raster = self.render(packed, view, trained, whole)
        picture = raster.picture
        pred = correction[:3, None, None] * picture + correction[3:, None, None]
        if counts is not None:
            pred, target = (torch.where(counts, planes, IGNORED) for planes in (pred, target))
        weight = self._dssim_weight
        l1, dssim = (pred - target).abs(), dissimilarity_map(pred, target, self._taps)
        photometric = (1 - weight) * l1.mean() + weight * dssim.mean()
        _, log_scales, _, logits, _ = parts_of(packed)
        count = max(len(packed), 1)
        regularisers = (
            self._opacity_reg / count * torch.sigmoid(logits).sum()
            + self._scale_reg / (3 * count) * log_scales.exp().sum()
        )
        told = photometric.detach()
        if raster.active is not None:
            pixels = _pixels_of(raster.active)[: view.camera.height_px, : view.camera.width_px]
            with torch.no_grad():
                told = (((1 - weight) * l1 + weight * dssim) * pixels).mean()
        return Compared(told, photometric + regularisers, picture, raster.active is None)


def _pixels_of(tiles: Tensor) -> Tensor:
    """(tiles_y * TILE_PX, tiles_x * TILE_PX) of flags (tiles_y, tiles_x)."""
    tiles_y, tiles_x = tiles.shape
    pixels = tiles[:, None, :, None].expand(tiles_y, TILE_PX, tiles_x, TILE_PX)
    return pixels.reshape(tiles_y * TILE_PX, tiles_x * TILE_PX)
