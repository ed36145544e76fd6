"""Relocation: dead Gaussians move to where living ones are, without changing the picture.

3D Gaussian splatting as Markov chain Monte Carlo (equations 9 to 11). Which Gaussians are dead, and
where they may move in a sliding window, stands in generations.py.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import comb

import numpy as np
import numpy.typing as npt

from codec.arrays import Doubles, Longs
from codec.errors import InvalidError
from trainer.step.raster import Parameters

MAX_COPIES = 51
"""Gaussians that may share one place, with the one that is there. 3DGS-MCMC."""


@dataclass(frozen=True)
class McmcConfig:
    """Relocation, renewal and the two regularisers."""

    relocate_period: int = 100
    """Iterations between relocations. From 3DGS-MCMC."""
    dead_opacity: float = 0.005
    """Opacity at or below which a Gaussian is dead. From 3DGS-MCMC."""
    settle_dead_opacity: float = 0.2
    """The same in the settling rounds of genesis. Fainter Gaussians form a haze that explains what
    single training cameras see; other cameras see more clearly without it."""
    renew_share: float = 0.01
    """Largest share of a slice's Gaussians that are moved at a window's start to places that its
    newest frame shows but the model does not render. The Gaussians with the least contribution in
    each layer are moved. 0 switches it off."""
    opacity_reg: float = 1e-3
    """Weight of the mean opacity in the loss. From 3DGS-MCMC for indoor scenes; its usual 0.01
    (paper, 8.1: 0.02) makes haze of a scene that is trained for thousands of iterations instead of
    tens of thousands."""
    scale_reg: float = 1e-3
    """Weight of the mean standard deviation (metres) in the loss. Paper, section 8.1: 0.01."""
    max_scale: float = 0.15
    """Largest standard deviation of a Gaussian of genesis, as a share of its distance from the
    cameras (root mean square over the cameras); 0 sets no bound. The middle of a larger Gaussian
    fits a few cameras, but its ends cover what other cameras see. 3DGS prunes Gaussians over 0.1 of
    the scene's extent."""

    def __post_init__(self) -> None:
        if self.relocate_period < 1:
            raise InvalidError(f"relocate_period {self.relocate_period}: choose 1 or more")
        for name in ("dead_opacity", "settle_dead_opacity"):
            if not 0 < getattr(self, name) < 1:
                raise InvalidError(f"{name} {getattr(self, name):g}: choose above 0, below 1")
        if not 0 <= self.renew_share <= 1:
            raise InvalidError(f"renew_share {self.renew_share:g}: choose 0 to 1")
        for name in ("opacity_reg", "scale_reg", "max_scale"):
            if not 0 <= getattr(self, name) < np.inf:
                raise InvalidError(f"{name} {getattr(self, name):g}: choose 0 or more")


def _binomial_table() -> Doubles:
    """table[N - 1, k] = the factor of o_new^(k + 1) in the denominator D of equation 9."""
    table = np.zeros((MAX_COPIES, MAX_COPIES))
    for n in range(1, MAX_COPIES + 1):
        for i in range(1, n + 1):
            for k in range(i):
                table[n - 1, k] += comb(i - 1, k) * (-1) ** k / np.sqrt(k + 1)
    return table


_TABLE = _binomial_table()


def split_opacity_and_scale(
    opacities: Doubles, copies: npt.NDArray[np.integer], min_opacity: float
) -> tuple[Doubles, Doubles]:
    """(M,) the opacity of each of `copies` Gaussians that replace one, and the factor of its
    scales.

    o_new = 1 - (1 - o)^(1/N); s_new = s o / sum_{i=1..N} sum_{k<i} C(i-1, k) (-1)^k o_new^(k+1) /
    sqrt(k+1) (3DGS-MCMC, equation 9): the picture of a flat-on Gaussian stays the same in its
    integral.
    """
    count = np.clip(copies, 1, MAX_COPIES)
    # Cut before the sum, as the scale must fit the opacity that is stored.
    new = np.clip(1 - (1 - opacities) ** (1 / count), min_opacity, 1 - 1e-7)
    powers = new[:, None] ** np.arange(1, MAX_COPIES + 1)
    return new, opacities / (_TABLE[count - 1] * powers).sum(axis=1)


def relocate(
    values: Parameters,
    dead: npt.NDArray[np.integer],
    alive: npt.NDArray[np.integer],
    min_opacity: float,
    rng: np.random.Generator,
) -> Longs:
    """Moves the rows `dead` onto rows drawn from `alive` in proportion to opacity.

    A dead row copies its target; both take the divided opacity and scales. Gives the target of
    every dead row, in order; their histories in the optimiser are the caller's to reset.
    """
    if len(dead) == 0 or len(alive) == 0:
        return np.zeros(0, np.int64)
    opacities = 1 / (1 + np.exp(-values.logit_opacities[alive].astype(np.float64)))
    drawn = rng.choice(len(alive), size=len(dead), p=opacities / opacities.sum())
    times = np.bincount(drawn, minlength=len(alive))
    hit = np.flatnonzero(times)
    new, factor = split_opacity_and_scale(opacities[hit], times[hit] + 1, min_opacity)
    targets = alive[hit]
    values.logit_opacities[targets] = np.log(new / (1 - new))
    values.log_scales[targets] += np.log(factor)[:, None].astype(np.float32)
    chosen = alive[drawn].astype(np.int64)
    for array in values.arrays:
        array[dead] = array[chosen]
    return chosen
