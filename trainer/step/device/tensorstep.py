"""One step in tensors: colours, loss, regularisers, Adam, noise and the bound of scales;
trainer.step.optimiser has the latter for arrays.

Rule: nothing here waits for the device. Parameters and gradients are rows (T, D), see `packedrows`.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import torch
from torch import Tensor

from codec.splats import SH_C0
from player.render.project import SH_C1, SH_C2, SH_C3, TILE_PX
from trainer.step.loss import C1, C2, IGNORED, RADIUS_PX, TAPS
from trainer.step.optimiser import (
    BETA1,
    BETA2,
    COUNTER_STEP,
    GATE_STEEPNESS,
    MIX_FACTORS,
    WEAKEST_NOISE,
    Adam,
    AgeScaling,
)

from .tensors import LOG_SCALES, LOGIT_OPACITY, MEANS, QUATS, Crossing, DeviceView, parts_of
from .torchrender import Solids, rotations


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
    """(N, 1) each of degree 2 and 3, of unit vectors; see player.render.project."""
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


class TensorAdam:
    """The histories of num_gs rows, each with its own count of steps."""

    def __init__(self, adam: Adam, crossing: Crossing) -> None:
        """Of no steps yet, with the rates of `adam`."""
        self._rates = crossing.send(adam.packed_rates)
        rows, columns = len(adam.steps), len(adam.packed_rates)
        self.first = self._rates.new_zeros(rows, columns)
        self.second = self._rates.new_zeros(rows, columns)
        self.steps = torch.zeros(rows, dtype=torch.int32, device=crossing.device)
        self._eps, self._mode = adam.config.eps, adam.config.age_scaling

    def update(
        self, values: Tensor, gradients: Tensor, rows: Tensor, means_lr_m: float, calm: float,
        decay: Tensor,
    ) -> None:  # fmt: skip
        """One update of `values` (T, D), the rows `rows` (T,) int64, in place; `gradients` may be
        changed. decay: (T,) factor of the positions' gradient or update, by age."""
        mode: AgeScaling = self._mode
        if mode == "gradient":
            gradients[:, MEANS] *= decay[:, None]
        steps = self.steps.index_select(0, rows).add_(1)
        self.steps.index_copy_(0, rows, steps)
        first = self.first.index_select(0, rows).mul_(BETA1).add_(gradients, alpha=1 - BETA1)
        self.first.index_copy_(0, rows, first)
        second = self.second.index_select(0, rows).mul_(BETA2)
        second.addcmul_(gradients, gradients, value=1 - BETA2)
        self.second.index_copy_(0, rows, second)
        counts = steps.float()[:, None]
        # In single precision as the kernel has it.
        bias1 = 1 - torch.exp(counts * math.log(BETA1))
        root = (1 - torch.exp(counts * math.log(BETA2))).rsqrt_()
        rates = self._rates * calm
        rates[MEANS] = means_lr_m
        moved = first.mul_(rates).div_(bias1).div_(second.sqrt_().mul_(root).add_(self._eps))
        if mode == "update":
            moved[:, MEANS] *= decay[:, None]
        values -= moved


def _signed(number: int) -> int:
    """The int64 of the same 64 bits."""
    number %= 1 << 64
    return number - (1 << 64) if number >> 63 else number


def _shifted(bits: Tensor, by: int) -> Tensor:
    """Unsigned shift to the right of int64."""
    return (bits >> by) & ((1 << (64 - by)) - 1)


def _mixed(bits: Tensor) -> Tensor:
    """The finaliser of SplitMix64, see trainer.step.optimiser."""
    for by, factor in zip((30, 27), MIX_FACTORS, strict=True):
        bits = (bits ^ _shifted(bits, by)) * _signed(factor)
    return bits ^ _shifted(bits, 31)


def _unit(bits: Tensor) -> Tensor:
    """24 bits as a number from 0 to 1."""
    return bits.float() * (1 / 16777216)


def normal_numbers(rows: Tensor, seed: int) -> Tensor:
    """(T, 3) normally distributed, from a counter: the same seed and row give the same, on the CPU
    those of `add_noise`. rows: (T,) int64."""
    state = _mixed(rows * _signed(COUNTER_STEP) + _signed(seed))
    a, b = _mixed(state + 1), _mixed(state + 2)
    u0, u2 = ((_shifted(bits, 40).float() + 0.5) * (1 / 16777216) for bits in (a, b))
    u1, u3 = (_unit(_shifted(bits, 8) & 0xFFFFFF) for bits in (a, b))
    r0, r1 = ((-2 * u.log()).sqrt() for u in (u0, u2))
    turn = 2 * math.pi
    return torch.stack([r0 * (turn * u1).cos(), r0 * (turn * u1).sin(), r1 * (turn * u3).cos()], 1)


def add_tensor_noise(
    values: Tensor, rows: Tensor, amount: float, opacity_gate: float, seed: int
) -> None:
    """`add_noise` to `values` (T, D), the rows `rows`, in place."""
    opacities = torch.sigmoid(values[:, LOGIT_OPACITY])
    gates = torch.sigmoid(GATE_STEEPNESS * (opacity_gate - opacities))
    gates = gates.where(gates >= WEAKEST_NOISE, 0)
    xi = normal_numbers(rows, seed) * (amount * gates)[:, None]
    axes = rotations(torch.nn.functional.normalize(values[:, QUATS], dim=1))
    # Sigma xi = R S^2 R^T xi
    along = (axes * xi[:, :, None]).sum(1) * torch.exp(2 * values[:, LOG_SCALES])
    values[:, MEANS] += (axes * along[:, None, :]).sum(2)


def bound_tensor_scales(
    values: Tensor, rows: Tensor, centre: Tensor, radius_m: float, max_scale: float
) -> None:
    """`bound_scales` of `values` (R, D), in place."""
    chosen = values.index_select(0, rows)
    apart = chosen[:, MEANS] - centre
    most = (apart.square().sum(1) + radius_m**2).sqrt_().mul_(max_scale).log_()
    chosen[:, LOG_SCALES] = chosen[:, LOG_SCALES].minimum(most[:, None])
    values.index_copy_(0, rows, chosen)


def sum_over_cells(gradients: Tensor, rows: Tensor, cells: Tensor, num_cells: int) -> None:
    """`move_together` for `gradients` (T, D) of the rows `rows`, in place. cells: (num_gs,)
    int64."""
    mine = cells.index_select(0, rows)
    sums = gradients.new_zeros(num_cells, 3).index_add_(0, mine, gradients[:, MEANS])
    gradients[:, MEANS] = sums.index_select(0, mine)
