"""Coherent motion: for a while, Gaussians that lie close together move as one.

What moves in a scene moves in pieces much larger than a Gaussian. The gradient of one shows only
how its own pixels would look better; that of a whole cell shows where the piece went.
"""

from __future__ import annotations

import numpy as np

from codec.arrays import Floats, Ints


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
