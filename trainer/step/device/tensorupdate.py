"""Adam, noise and the bound of scales in tensors; trainer.step.optimiser has them for arrays.

Parameters and gradients are rows (T, D), see `packedrows`. Nothing here waits for the device.
"""

from __future__ import annotations

import math

import torch
from torch import Tensor

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

from .crossing import Crossing
from .packedrows import LOG_SCALES, LOGIT_OPACITY, MEANS, QUATS
from .torchproject import rotations


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
