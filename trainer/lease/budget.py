"""How many slots may be active so that a stream keeps to a number of bytes a frame.

Pure: what slices took comes in, a number of slots goes out.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

HORIZON_FRAMES = 30
"""Frames in which what was spent too much, or too little, is made good."""

FIRST_SLOT_BYTES = 5.0
"""Size of an active slot while no slice has been measured."""

MEMORY = 0.8
"""How much the price of a slot stays that of the slices before, from slice to slice."""


class ByteBudget:
    """The price of an active slot, and what is owed."""

    def __init__(self, bytes_per_frame: float) -> None:
        self.bytes_per_frame = bytes_per_frame
        self._state = np.array([FIRST_SLOT_BYTES, 0.0])  # price, owed bytes

    @property
    def slots(self) -> int:
        """How many slots the next slice may have active."""
        price, owed = self._state
        return max(0, int((self.bytes_per_frame - owed / HORIZON_FRAMES) / price))

    def record_sent_bytes(self, num_bytes: int, slots: int) -> None:
        """A slice with so many active slots took `num_bytes`."""
        if slots:
            price = num_bytes / slots
            self._state[0] = max(MEMORY * self._state[0] + (1 - MEMORY) * price, 1e-3)
        self._state[1] += num_bytes - self.bytes_per_frame
        # A quiet minute must not pay for a wild one: that would overfill a link.
        self._state[1] = max(self._state[1], -HORIZON_FRAMES * self.bytes_per_frame / 2)

    def state(self) -> npt.NDArray[np.float64]:
        """The numbers that change; a view."""
        return self._state
