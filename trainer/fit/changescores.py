"""How much each Gaussian has to do with what has changed from one frame to the next."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from player.render.recipe import TILE_PX
from trainer.step.raster import Rendered, weighed

Floats = npt.NDArray[np.float32]
Doubles = npt.NDArray[np.float64]
Flags = npt.NDArray[np.bool_]

LEAST_CHANGE = 3e-4
"""Squared colour difference that may come from noise."""

ERROR_WEIGHT = 0.03
"""Weight of the error of pixels that did not change, beside those that did."""


def _smoothed(differences: Floats) -> Floats:
    """(H, W, 3): means over 3 x 3 pixels; beyond the border the nearest pixel counts again."""
    padded = np.pad(differences, ((1, 1), (1, 1), (0, 0)), mode="edge")
    rows = padded[:-2] + padded[1:-1] + padded[2:]
    blurred: Floats = (rows[:, :-2] + rows[:, 1:-1] + rows[:, 2:]) / np.float32(9)
    return blurred


class ChangeScores:
    """Sums over cameras of what M Gaussians have to do with change.

    For a camera let W be a Gaussian's blending weights summed over the pixels, X the same of
    weight times the pixel's growth in squared error since the frame before, R of weight times its
    squared error. A score is (sum sqrt(W X))^2 / sum W + 0.03 (sum sqrt(W R))^2 / sum W: what many
    cameras see changed counts more than what one does.
    """

    def __init__(self, count: int) -> None:
        self._weights, self._changed, self._wrong = (np.zeros(count) for _ in range(3))

    def add(self, rendered: Rendered, now: Floats, before: Floats, counts: Flags) -> Floats:
        """Takes in one camera; gives (M,) the Gaussians' weights.

        now, before: (H, W, 3) the rendered picture minus what the camera sees now, and saw before;
        counts: (H, W) the pixels that count.
        """
        wrong = np.square(_smoothed(now)).sum(axis=2)
        changed = np.maximum(wrong - np.square(_smoothed(before)).sum(axis=2) - LEAST_CHANGE, 0)
        height, width = counts.shape
        planes = np.zeros_like(rendered.picture)
        assert planes.shape[1] % TILE_PX == 0
        for plane, values in zip(planes, (np.ones_like(wrong), changed, wrong), strict=True):
            plane[:height, :width] = np.where(counts, values, 0)
        weights, of_changed, of_wrong = weighed(rendered, planes)
        self._weights += weights
        self._changed += np.sqrt(np.maximum(weights * of_changed, 0))
        self._wrong += np.sqrt(np.maximum(weights * of_wrong, 0))
        return weights

    @property
    def scores(self) -> Doubles:
        """(M,) the scores; 0 for what no camera sees."""
        weights = np.maximum(self._weights, 1e-12)
        scores: Doubles = (self._changed**2 + ERROR_WEIGHT * self._wrong**2) / weights
        return scores
