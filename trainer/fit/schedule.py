"""The work of each iteration of a window, and its falling learning rates."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from codec.arrays import Ints

from .config import FitConfig

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
