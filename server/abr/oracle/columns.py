"""The variables of the programme behind the bound."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray


class Columns:
    """Where each variable is; arrays of int64."""

    def __init__(self, upper: int, groups: int, offers: int, steps: int, begin: bool) -> None:
        """upper: layers but layer 0; begin: whether layers have to begin."""
        self.count = 0
        self.done = self._next(groups)
        """Bytes that have passed with the group, in units."""
        self.bought = self._next(offers)
        self.share = self._next(upper, groups)
        self.store = self._next(upper, groups)
        """Frames of the layer that are in store behind the group."""
        self.begun = self._next(upper if begin else 0, groups)
        """Snapshots of the layer that have come, up to 1."""
        self.step = self._next(steps)
        """Between a stretch and the next, dB."""

    def _next(self, *shape: int) -> NDArray[np.int64]:
        begin, self.count = self.count, self.count + int(np.prod(shape))
        return np.arange(begin, self.count, dtype=np.int64).reshape(shape)
