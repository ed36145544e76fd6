"""The settings of the sliding-window training, among them the weights of the loss, and the plan by
which they train a window: its iterations, and their falling learning rates.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field

from codec.arrays import Ints
from codec.errors import InvalidError
from codec.slice import MAX_SWIN_SIZE
from codec.splats import MAX_SH_DEGREE
from trainer.lease.leases import LeaseConfig
from trainer.step.backend import BackendName
from trainer.step.device.pick import Picked, Weights, pick_backend
from trainer.step.optimiser import OptimiserConfig

from .mcmc import McmcConfig


@dataclass(frozen=True)
class FitConfig:
    """Settings of the sliding-window training; times are frames, sizes Gaussians."""

    num_gs: int = 20_000
    """Number of active Gaussians in a frame. Paper: 200,000 on a GPU; 20,000 suits two CPU
    cores."""
    swin_size: int = 1
    """Length of the sliding window, frames: the duration of a lease, or the lifetime of a Gaussian
    that is sent whole. Leases work best with 1, because moving Gaussians can then follow every
    frame; Gaussians that are sent whole need more. Paper, section 8.1: 5."""
    sh_degree: int = 0
    """Degree of the colour's spherical harmonics, 0 to 3: how much it may depend on where it is
    seen from. The paper trains 1 and streams 0."""
    genesis_iterations: int = 3_000
    """Number of iterations of the first window (genesis), before its settling rounds; 0 if
    --initial gives its Gaussians. Paper: 30,000 on a GPU."""
    coarse_share: float = 0.6
    """Share of the iterations of genesis, from its beginning, that use pictures of half the size,
    so that the cameras agree on shapes before training fits detail; 0 switches it off."""
    window_coarse_share: float = 0.0
    """The same share of the iterations of every later window and settling round."""
    settle_rounds: int = 20
    """Number of settling rounds after genesis. Each trains the first window once more like a later
    window: Gaussians are renewed first, and the learning rates start high again."""
    window_iterations: int = 400
    """Number of iterations of every later window and settling round. Paper: 2,000 on a GPU."""
    newest_share: float = 0.5
    """Share of a window's iterations spent on its newest frame, if no earlier window has seen that
    frame."""
    error_share: float = 0.5
    """Share of a later window's iterations that is distributed over the cameras by their error
    where they see trained Gaussians; the rest is distributed evenly. Applies only to leased
    slots."""
    dssim_weight: float = 0.2
    """Weight of 1 - SSIM beside L1 in the loss. From 3DGS."""
    colour_lr: float = 1e-3
    """Learning rate of the per-camera colour correction; 0 switches it off."""
    calm_from: float = 0.7
    """Share of a window's iterations after which the learning rates other than the positions' fall
    too, to a tenth; 1 keeps them constant."""
    together_share: float = 0.1
    """Share of a window's iterations in which all Gaussians of a large cell move together, followed
    by the same share for smaller cells. Applies only to leased slots."""
    scene_flow: bool = False
    """Before a window trains, move each Gaussian that the cameras saw move, together with its
    neighbours, to where they see it now. Applies only to leased slots."""
    settle_base_share: float = 0.0
    """Share of the settling rounds, the first ones, that train the first layer as a scene of its
    own. The other layers then begin as covers of it, no Gaussian is relocated onto one of a lower
    layer, and each layer changes by as large a share of its slots. Makes lower layers better and
    smaller; 1/3 with `prefix_share` 0.3, `settle_prefix_share` 0.1 and 800 `window_iterations` was
    measured. 0 trains all layers together. Applies only to leased slots."""
    settle_prefix_share: float = 0.25
    """Share of the iterations of the settling rounds that render only the first layers, so that
    these look right without the others. Applies only to leased slots."""
    prefix_share: float = 0.1
    """Share of a later window's iterations that render only the first layers, for the same
    purpose."""
    seed: int = 0
    """Seed of every random choice."""
    optimiser: OptimiserConfig = field(default_factory=OptimiserConfig)
    """Learning rates."""
    mcmc: McmcConfig = field(default_factory=McmcConfig)
    """Relocation, renewal and regularisers."""
    lease: LeaseConfig = field(default_factory=LeaseConfig)
    """Share of each slice that is trained and sent."""

    def __post_init__(self) -> None:
        if not 1 <= self.swin_size <= MAX_SWIN_SIZE:
            raise InvalidError(f"swin_size {self.swin_size}: choose 1 to {MAX_SWIN_SIZE}")
        if self.seed < 0:
            raise InvalidError(f"seed {self.seed}: choose 0 or more")
        if self.num_gs < self.swin_size or self.num_gs % self.swin_size:
            raise InvalidError(
                f"num_gs {self.num_gs} is not a multiple of swin_size {self.swin_size}"
            )
        if not 0 <= self.sh_degree <= MAX_SH_DEGREE:
            raise InvalidError(f"sh_degree {self.sh_degree}: choose 0 to {MAX_SH_DEGREE}")
        if self.settle_rounds < 0:
            raise InvalidError(f"settle_rounds {self.settle_rounds}: choose 0 or more")
        if self.genesis_iterations < 0 or self.window_iterations < 1:
            raise InvalidError("genesis_iterations below 0, or window_iterations below 1")
        if not self.genesis_iterations and not self.settle_rounds:
            raise InvalidError("genesis_iterations 0 and settle_rounds 0 leave nothing to train")
        for name in (
            "coarse_share",
            "window_coarse_share",
            "newest_share",
            "dssim_weight",
            "calm_from",
            "error_share",
            "prefix_share",
            "settle_base_share",
            "settle_prefix_share",
        ):
            if not 0 <= getattr(self, name) <= 1:
                raise InvalidError(f"{name} {getattr(self, name):g}: choose 0 to 1")

    @property
    def base_rounds(self) -> int:
        """How many settling rounds, the first ones, train the first layer by itself: some, if any
        share of them, and never the last one."""
        wanted = math.ceil(round(self.settle_base_share * self.settle_rounds, 6))
        return min(wanted, max(self.settle_rounds - 1, 0))

    def iterations(self, first_frame: int) -> int:
        """Number of iterations of the window that starts at `first_frame`."""
        if first_frame:
            return self.window_iterations
        return self.genesis_iterations + self.settle_rounds * self.window_iterations

    def backend(self, name: BackendName, device: str | None = None) -> Picked:
        """The backend `name` for this loss; device: of backend torch. Raises InvalidError where it
        cannot run."""
        weights = Weights(self.dssim_weight, self.mcmc.opacity_reg, self.mcmc.scale_reg)
        return pick_backend(name, weights, device)


CALM_END = 0.1
"""Factor that the learning rates other than the positions' have reached at the end of a window."""

GENESIS_NOISE = 5e5
"""Noise of genesis, as a multiple of the positions' learning rate. From 3DGS-MCMC."""

WINDOW_NOISE = 5e4
"""Noise of later windows, as a multiple of the positions' learning rate, which restarts higher
there. Paper, section 8.1."""


@dataclass(frozen=True, slots=True)
class Rates:
    """How far one iteration moves the parameters."""

    means_lr_m: float
    """Learning rate of positions, metres."""
    noise_m: float
    """The noise's."""
    calm: float
    """Factor of the other learning rates."""


@dataclass(frozen=True, slots=True)
class Schedule:
    """The iterations of one window."""

    iterations: int
    half_until: float
    """The iteration from which on shots are whole."""
    means_lr: float
    """Learning rate of positions at the beginning, over the scene's extent."""
    means_lr_end: float
    """The same at the end."""
    noise: float
    """Multiple of that learning rate."""
    calm_from: float
    """Share of the iterations after which the other rates fall."""

    @staticmethod
    def genesis(config: FitConfig) -> Schedule:
        """Schedule of the first window."""
        rates = config.optimiser
        return Schedule(
            config.genesis_iterations,
            config.coarse_share * config.genesis_iterations,
            rates.means_lr,
            rates.means_lr_end,
            GENESIS_NOISE,
            config.calm_from,
        )

    @staticmethod
    def window(config: FitConfig, means_lr: float) -> Schedule:
        """Schedule of a window whose learning rate of positions begins at `means_lr`."""
        rates = config.optimiser
        return Schedule(
            config.window_iterations,
            config.window_coarse_share * config.window_iterations,
            means_lr,
            means_lr * rates.window_means_lr_end / rates.window_means_lr,
            WINDOW_NOISE,
            config.calm_from,
        )

    def is_half(self, iteration: int) -> bool:
        """Whether an iteration sees pictures of half the size."""
        return iteration < self.half_until

    def rates(self, iteration: int, extent_m: float) -> Rates:
        """The rates of an iteration, which fall log-linearly."""
        decay = self.means_lr_end / self.means_lr
        means_lr_m = float(extent_m * self.means_lr * decay ** (iteration / self.iterations))
        over = iteration / self.iterations - self.calm_from
        calm = float(CALM_END ** (over / (1 - self.calm_from))) if over > 0 else 1.0
        return Rates(means_lr_m, self.noise * means_lr_m, calm)


@dataclass(frozen=True, slots=True)
class WindowPlan:
    """How one window is trained."""

    frames: range
    schedule: Schedule
    settled: int | None
    """In genesis, the settling rounds before this one; None while it has not begun to settle."""
    before: int
    """Iterations of this window that earlier plans have done."""
    begin: int
    """Iterations of this plan that a restored state has behind it."""
    brings_new: bool
    """Whether no earlier window has seen the newest frame: not in genesis, nor in the last windows
    of a video."""
    newest_share: float
    """Share of the iterations that see the newest frame in any case."""
    together_share: float
    """Share of the iterations that each size of cells gets."""
    # A strategy may choose otherwise when the window begins.
    error_share: float = 0.0
    """Share of the iterations that goes to cameras by how much is wrong in them."""
    whole: bool = True
    """Whether all of a picture is compared, see `Backend.step`."""
    together: Sequence[Ints] = ()
    """(N,) the cell of each Gaussian, for ever smaller cells whose Gaussians move together."""

    @property
    def is_genesis(self) -> bool:
        """Whether it is the first window, from which nothing has been sent yet."""
        return self.frames.start == 0

    def level(self, iteration: int) -> int | None:
        """Which of the cells move together in an iteration; None if each Gaussian moves by
        itself."""
        if not self.together:
            return None
        level = int(iteration / (self.together_share * self.schedule.iterations))
        return level if level < len(self.together) else None
