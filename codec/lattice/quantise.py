"""How finely Gaussians are quantised, and the exact arithmetic back to floats.

Rule: what makes floats of integers does the operations that FORMAT.md states, in its order and
precision, so that any decoder gives the same bits. What a quantiser chooses is free.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from codec.arrays import Doubles, Floats
from codec.kernel import kernel
from codec.splats import Splats

MAX_OPACITY_LEVELS = 256
MAX_LOGIT = 16.0

# Found on trained models by rendering: each bit then buys about the same in every attribute, and
# the picture loses about 0.05 dB, measured in bench/NOTEBOOK.md.
POSITION_PER_SIZE = 1 / 11
BASE_LOG_SCALE = 0.125
BASE_ROTATION = 1 / 60
BASE_COLOUR = 0.056

MIN_COARSENESS, MAX_COARSENESS = 0.5, 4.0
"""How far the steps of a layer may lie from those of its slice."""


def _log_paint(splats: Splats) -> Doubles:
    """(N,) log of opacity times the radius of the widest section: how much an error shows."""
    log_opacity = -np.logaddexp(0.0, -splats.logit_opacities.astype(np.float64))
    return log_opacity + _log_radius(splats)


def _log_radius(splats: Splats) -> Doubles:
    """(N,) log of the geometric mean of the two larger standard deviations."""
    # Column by column: reducing rows of three costs several times as much.
    x, y, z = splats.log_scales.T.astype(np.float64)
    radius: Doubles = (x + y + z - np.minimum(np.minimum(x, y), z)) / 2
    return radius


def position_step_m(splats: Splats) -> float:
    """The step of positions that suits `splats`: it follows their sizes, for a scene may have any
    scale."""
    if len(splats):
        weights = splats.opacities.astype(np.float64) + 1e-6
        log_size = (weights * _log_radius(splats)).sum() / weights.sum()
    else:
        log_size = 0.0
    # At least 1e-6 m, so that hostile or broken input never divides by zero.
    return max(POSITION_PER_SIZE * float(np.exp(np.clip(log_size, -30, 30))), 1e-6)


def layer_coarseness(layers: Sequence[Splats]) -> list[float]:
    """Factors of the steps for each layer of one slice: the less its Gaussians paint, the coarser.

    Each layer then adds about the same error to the picture, which saves 5 % of the bytes at equal
    quality.
    """
    paint = [np.exp(np.clip(_log_paint(layer), -60, 60)) for layer in layers]
    mean = np.concatenate(paint).mean() if any(map(len, paint)) else 1.0
    factors = [np.sqrt(mean / values.mean()) if len(values) else 1.0 for values in paint]
    return [float(np.clip(factor, MIN_COARSENESS, MAX_COARSENESS)) for factor in factors]


def to_luma(rgb: Doubles) -> Doubles:
    """(..., 3) Y, Co, Cg of (..., 3) RGB coefficients."""
    red, green, blue = rgb[..., 0], rgb[..., 1], rgb[..., 2]
    luma = (red + 2 * green + blue) / 4
    return np.stack([luma, (red - blue) / 2, (2 * green - red - blue) / 4], axis=-1)


@kernel(nogil=True)
def from_luma(y, co, cg):  # type: ignore[no-untyped-def]
    """Red, green, blue, all float32: G = Y + Cg, t = Y - Cg, R = t + Co, B = t - Co."""
    rest = y - cg
    return rest + co, y + cg, rest - co


def opacity_logits(levels: int) -> Floats:
    """(levels,) the logit of each opacity q / (levels - 1), rounded once to float32.

    Opacities 0 and 1 have no logit; MAX_LOGIT stands for them, which draws the same.
    """
    numbers = np.arange(1, levels - 1, dtype=np.float64)
    logits = np.full(levels, -MAX_LOGIT, np.float32)
    logits[1:-1] = np.log(numbers / (levels - 1 - numbers))
    logits[-1] = MAX_LOGIT
    return logits
