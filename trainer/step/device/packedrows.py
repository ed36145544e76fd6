"""Parameters as one tensor, a row for each Gaussian: a step gathers and writes rows once."""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt
from torch import Tensor

from codec.arrays import Floats
from trainer.step.raster import Parameters

MEANS = slice(0, 3)
LOG_SCALES = slice(3, 6)
QUATS = slice(6, 10)
LOGIT_OPACITY = 10
SH = slice(11, None)

COLUMNS = (MEANS, LOG_SCALES, QUATS, slice(LOGIT_OPACITY, LOGIT_OPACITY + 1), SH)
"""In the order of `Parameters.arrays`."""


def pack(parameters: Parameters, rows: npt.NDArray[np.integer]) -> Floats:
    """(M, D) float32: the rows of `parameters`."""
    arrays = parameters.arrays
    parts = [array[rows].reshape(len(rows), math.prod(array.shape[1:])) for array in arrays]
    packed: Floats = np.concatenate(parts, axis=1)
    return packed


def unpack(packed: Floats, parameters: Parameters) -> None:
    """Writes (M, D) into the first M rows of `parameters`."""
    for array, columns in zip(parameters.arrays, COLUMNS, strict=True):
        array[: len(packed)] = packed[:, columns].reshape(len(packed), *array.shape[1:])


def parts_of(packed: Tensor) -> tuple[Tensor, Tensor, Tensor, Tensor, Tensor]:
    """Views of (M, D): means (M, 3), log_scales (M, 3), quats (M, 4), logit_opacities (M,) and sh
    (M, K, 3)."""
    return (
        packed[:, MEANS],
        packed[:, LOG_SCALES],
        packed[:, QUATS],
        packed[:, LOGIT_OPACITY],
        packed[:, SH].reshape(len(packed), (packed.shape[1] - SH.start) // 3, 3),
    )
