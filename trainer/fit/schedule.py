"""What changes from iteration to iteration of a window: sizes of pictures and learning rates."""

from __future__ import annotations

from dataclasses import dataclass

from .config import FitConfig


@dataclass(frozen=True, slots=True)
class Schedule:
    """The iterations of one window."""

    iterations: int
    half_until: float
    """The iteration from which on shots are whole."""
    means_lr: float
    """Of positions at the beginning, over the scene's extent."""
    means_lr_end: float
    """The same at the end."""
    noise_lr: float
    calm_from: float
    """Share of the iterations after which the other rates fall."""
    calm_end: float
    """What they have fallen to at the end, as a share."""

    @staticmethod
    def genesis(config: FitConfig, coarse_share: float) -> Schedule:
        """That of the first window. coarse_share: of its iterations that see half pictures."""
        rates = config.optimiser
        return Schedule(
            config.genesis_iterations,
            coarse_share * config.genesis_iterations,
            rates.means_lr,
            rates.means_lr_end,
            config.mcmc.noise_lr,
            config.calm_from,
            config.calm_end,
        )

    @staticmethod
    def window(config: FitConfig, means_lr: float) -> Schedule:
        """That of a window whose learning rate of positions begins at `means_lr`."""
        rates = config.optimiser
        return Schedule(
            config.window_iterations,
            0,
            means_lr,
            means_lr * rates.window_means_lr_end / rates.window_means_lr,
            config.mcmc.window_noise_lr,
            config.calm_from,
            config.calm_end,
        )

    def means_lr_m(self, iteration: int, extent_m: float) -> float:
        """The learning rate of positions, metres, which falls log-linearly."""
        decay = self.means_lr_end / self.means_lr
        return float(extent_m * self.means_lr * decay ** (iteration / self.iterations))

    def calm(self, iteration: int) -> float:
        """What the other learning rates are multiplied by; falls log-linearly."""
        over = iteration / self.iterations - self.calm_from
        return float(self.calm_end ** (over / (1 - self.calm_from))) if over > 0 else 1.0
