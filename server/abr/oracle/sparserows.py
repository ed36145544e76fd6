"""Rows of a linear programme, written one by one."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array

Floats = NDArray[np.float64]
Row = dict[int, float]
"""Number of a variable -> what it is multiplied by."""


@dataclass(slots=True)
class SparseRows:
    """Rows that say: the products, summed up, are at most a number."""

    rows: list[Row] = field(default_factory=list)
    most: list[float] = field(default_factory=list)

    def add(self, *parts: Row, most: float = 0.0) -> None:
        """A row of `parts` that have no variable in common."""
        self.rows.append({place: factor for part in parts for place, factor in part.items()})
        self.most.append(most)

    def copy(self) -> SparseRows:
        """One whose rows may be changed."""
        return SparseRows([dict(row) for row in self.rows], list(self.most))

    def matrix(self, width: int) -> csr_array:
        """(rows, width) float64"""
        data = [factor for row in self.rows for factor in row.values()]
        places = [place for row in self.rows for place in row]
        starts = np.cumsum([0, *map(len, self.rows)])
        return csr_array((data, places, starts), shape=(len(self.rows), width))
