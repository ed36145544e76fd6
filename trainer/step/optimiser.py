"""Adam over the rows that a picture touches, the noise of stochastic gradient Langevin dynamics,
and the bound of scales in genesis.

Every row counts its own steps: rows of different ages are optimised together (paper, section
4.5.1), and a row whose Gaussian was relocated starts afresh. For a while, Gaussians that lie close
together move as one: what moves in a scene moves in pieces much larger than a Gaussian, whose
gradient shows only how its own pixels would look better; that of a whole cell shows where the piece
went.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
import numpy.typing as npt

from codec.arrays import Doubles, Floats, Ints
from codec.camera import Camera
from codec.kernel import kernel, prange
from player.render.project import rotation_of

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


def cells_of(means: Floats, size_m: float) -> Ints:
    """(N,) int32: the cell, a cube of side `size_m`, that each of (N, 3) positions lies in."""
    corners = np.floor(means / np.float32(size_m)).astype(np.int64)
    corners -= corners.min(axis=0)
    spans = corners.max(axis=0) + 1
    keys = (corners[:, 0] * spans[1] + corners[:, 1]) * spans[2] + corners[:, 2]
    cells: Ints = np.unique(keys, return_inverse=True)[1].astype(np.int32)
    return cells


def move_together(gradients: Floats, rows: Ints, cells: Ints) -> None:
    """Replaces the gradients (N, 3) of `rows` by the sums over their cells, in place."""
    mine = cells[rows]
    for axis in range(3):
        sums = np.bincount(mine, gradients[rows, axis])
        gradients[rows, axis] = sums[mine]


BETA1 = 0.9
BETA2 = 0.999

LOG_SCALES_LR, QUATS_LR, LOGIT_OPACITIES_LR, SH_LR = 5e-3, 1e-3, 5e-2, 2.5e-3
"""Learning rates of all but positions. SH_LR is that of the constant colour, and a twentieth of it
that of the other harmonics. From 3DGS."""

GATE_STEEPNESS = 100.0
"""How sharply the noise ends where opacity rises above that of the dead. 3DGS-MCMC."""

WEAKEST_NOISE = 1e-6
"""Share of the noise below which a Gaussian gets none."""

COUNTER_STEP = 0x9E3779B97F4A7C15
"""SplitMix64 counts in steps of it; a row's number is its count."""

MIX_FACTORS = (0xBF58476D1CE4E5B9, 0x94D049BB133111EB)
"""Those of the finaliser of SplitMix64."""

AgeScaling = Literal["off", "gradient", "update"]
"""Where the factor 1 / (1 + windows trained) applies to positions: nowhere, or to one of these."""


@dataclass(frozen=True)
class OptimiserConfig:
    """Learning rates of positions per Adam step, and Adam's settings."""

    means_lr: float = 1.6e-4
    """Learning rate of positions at the start of genesis, multiplied by the scene's extent
    (metres). From 3DGS."""
    means_lr_end: float = 1.6e-6
    """Learning rate of positions at the end of genesis, in the same unit; it falls log-linearly.
    From 3DGS."""
    window_means_lr: float = 4e-4
    """Learning rate of positions at the start of every later window, in the same unit. Paper:
    1.6e-4, as in genesis."""
    window_means_lr_end: float = 6.4e-6
    """Learning rate of positions at the end of a later window, in the same unit; settling rounds
    fall by the same factor."""
    eps: float = 1e-15
    """Adam's epsilon. From 3DGS."""
    carry_adam: bool = True
    """Keep Adam's history from window to window; if off, every window starts it afresh."""
    age_scaling: AgeScaling = "update"
    """Quantity of positions that is multiplied by 1 / (1 + windows trained): none (off), the
    gradient (paper, 4.5.1; nearly no effect under Adam), or Adam's update (the decaying rate that
    the paper intends)."""


@kernel(fastmath=True, parallel=True)
def _adam_kernel(  # type: ignore[no-untyped-def]
    values, gradients, first, second, steps, rows, rates, gradient_scale, update_scale, eps
):
    """values, gradients, first, second (R, D); steps (R,) already counted; rates (D,)."""
    beta1, beta2 = np.float32(BETA1), np.float32(BETA2)
    one = np.float32(1)
    for i in prange(rows.shape[0]):
        row = rows[i]
        count = np.float32(steps[row])
        bias1 = one - np.exp(count * np.log(beta1))
        bias2 = one - np.exp(count * np.log(beta2))
        root = one / np.sqrt(bias2)
        scale = update_scale[row] / bias1
        for d in range(values.shape[1]):
            g = gradients[row, d] * gradient_scale[row]
            m = beta1 * first[row, d] + (one - beta1) * g
            v = beta2 * second[row, d] + (one - beta2) * g * g
            first[row, d] = m
            second[row, d] = v
            values[row, d] -= rates[d] * scale * m / (np.sqrt(v) * root + eps)


@kernel()
def _count_steps(steps, rows):  # type: ignore[no-untyped-def]
    for row in rows:
        steps[row] += 1


class Adam:
    """Adam state for the first `rows` rows of the parameters; see `_adam_kernel`."""

    def __init__(self, rows: int, sh_degree: int, config: OptimiserConfig) -> None:
        self.config = config
        self.first = Parameters.zeros(rows, sh_degree)
        self.second = Parameters.zeros(rows, sh_degree)
        self.steps = np.zeros(rows, np.int32)
        self._ones = np.ones(rows, np.float32)
        sh_rates = np.full(self.first.sh[0].size, SH_LR / 20, np.float32)
        sh_rates[:3] = SH_LR
        self._rates = (
            np.full(3, LOG_SCALES_LR, np.float32),
            np.full(4, QUATS_LR, np.float32),
            np.full(1, LOGIT_OPACITIES_LR, np.float32),
            sh_rates,
        )

    @property
    def packed_rates(self) -> Floats:
        """(D,) the rates of a row's numbers, one attribute after the other; positions, whose rate
        is given with each step, have 0."""
        return np.concatenate([np.zeros(3, np.float32), *self._rates])

    def reset(self, rows: npt.NDArray[np.integer]) -> None:
        """Forgets the history of `rows`."""
        for state in (self.first, self.second):
            for array in state.arrays:
                array[rows] = 0
        self.steps[rows] = 0

    def move(self, rows: npt.NDArray[np.integer], origins: npt.NDArray[np.integer]) -> None:
        """Row rows[i] takes over the history of row origins[i]."""
        for state in (self.first, self.second):
            for array in state.arrays:
                array[rows] = array[origins]
        self.steps[rows] = self.steps[origins]

    def step(
        self,
        values: Parameters,
        gradients: Parameters,
        rows: Ints,
        means_lr_m: float,
        ages: Floats,
        calm: float = 1.0,
    ) -> None:
        """One update of `rows`. means_lr_m: the rate of positions, metres; ages (R,) float32:
        windows trained so far; calm: what the other rates are multiplied by."""
        _count_steps(self.steps, rows)
        decay = np.float32(1) / (np.float32(1) + ages)
        mode = self.config.age_scaling
        others = (rate * np.float32(calm) for rate in self._rates)
        rates = (np.full(3, means_lr_m, np.float32), *others)
        eps = np.float32(self.config.eps)
        states = zip(self.first.arrays, self.second.arrays, rates, strict=True)
        arrays = zip(values.arrays, gradients.arrays, states, strict=True)
        for which, (value, gradient, (first, second, rate)) in enumerate(arrays):
            is_means = which == 0
            _adam_kernel(
                value.reshape(len(value), -1),
                gradient.reshape(len(gradient), -1),
                first.reshape(len(first), -1),
                second.reshape(len(second), -1),
                self.steps,
                rows,
                rate,
                decay if is_means and mode == "gradient" else self._ones,
                decay if is_means and mode == "update" else self._ones,
                eps,
            )


@kernel(inline="always")
def _mix(x):  # type: ignore[no-untyped-def]
    """The finaliser of SplitMix64: 64 well mixed bits from any 64."""
    x = (x ^ (x >> np.uint64(30))) * np.uint64(MIX_FACTORS[0])
    x = (x ^ (x >> np.uint64(27))) * np.uint64(MIX_FACTORS[1])
    return x ^ (x >> np.uint64(31))


@kernel(parallel=True)
def add_noise(  # type: ignore[no-untyped-def]
    means, log_scales, quats, logit_opacities, rows, amount, opacity_gate, gate_steepness, seed
):
    """means += Sigma xi, xi ~ N(0, I) amount sigmoid(steepness (gate - opacity)), for `rows`.

    Sigma is the Gaussian's covariance itself, not its root (3DGS-MCMC, equation 9). Numbers come
    from a counter (seed, row), so threads do not change them.
    """
    one, two = np.float32(1), np.float32(2)
    for i in prange(rows.shape[0]):
        row = rows[i]
        opacity = one / (one + np.exp(-logit_opacities[row]))
        gate = one / (one + np.exp(gate_steepness * (opacity - opacity_gate)))
        if gate < np.float32(WEAKEST_NOISE):
            continue
        scale = amount * gate
        state = _mix(np.uint64(seed) + np.uint64(row) * np.uint64(COUNTER_STEP))
        a = _mix(state + np.uint64(1))
        b = _mix(state + np.uint64(2))
        unit = np.float32(1.0 / 16777216.0)
        u0 = (np.float32(a >> np.uint64(40)) + np.float32(0.5)) * unit
        u1 = np.float32((a >> np.uint64(8)) & np.uint64(0xFFFFFF)) * unit
        u2 = (np.float32(b >> np.uint64(40)) + np.float32(0.5)) * unit
        u3 = np.float32((b >> np.uint64(8)) & np.uint64(0xFFFFFF)) * unit
        turn = np.float32(2 * np.pi)
        r0, r1 = np.sqrt(-two * np.log(u0)), np.sqrt(-two * np.log(u2))
        x = scale * r0 * np.cos(turn * u1)
        y = scale * r0 * np.sin(turn * u1)
        z = scale * r1 * np.cos(turn * u3)
        qw, qx, qy, qz = quats[row, 0], quats[row, 1], quats[row, 2], quats[row, 3]
        norm = one / np.sqrt(qw * qw + qx * qx + qy * qy + qz * qz)
        g00, g01, g02, g10, g11, g12, g20, g21, g22 = rotation_of(
            qw * norm, qx * norm, qy * norm, qz * norm
        )
        # Sigma xi = R S^2 R^T xi
        l0 = (g00 * x + g10 * y + g20 * z) * np.exp(two * log_scales[row, 0])
        l1 = (g01 * x + g11 * y + g21 * z) * np.exp(two * log_scales[row, 1])
        l2 = (g02 * x + g12 * y + g22 * z) * np.exp(two * log_scales[row, 2])
        means[row, 0] += g00 * l0 + g01 * l1 + g02 * l2
        means[row, 1] += g10 * l0 + g11 * l1 + g12 * l2
        means[row, 2] += g20 * l0 + g21 * l1 + g22 * l2
