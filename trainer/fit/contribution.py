"""What Gaussians contribute to the cameras' views: the measure of importance that ranks them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from trainer.capture.capture import Mask
from trainer.step.raster import Ints, Parameters, View, render
from trainer.step.weights import contribution


def summed_contribution(
    values: Parameters, rows: Ints, views: Sequence[View], masks: Sequence[Mask | None]
) -> npt.NDArray[np.float64]:
    """(M,) the blending weight of each of the Gaussians `rows`, which are all that is shown, summed
    over the pixels of `views` that count. masks: one for each view."""
    sums = np.zeros(len(rows), np.float64)
    for view, mask in zip(views, masks, strict=True):
        sums += contribution(render(values, rows, view), mask)
    return sums
