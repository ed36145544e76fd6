"""Lifespans: the sliding window over slots, slices and generations (paper, Algorithm 1).

Pure bookkeeping in frames; no parameter of a Gaussian is seen here. Rows 0..num_gs-1 are the
generation being optimised, rows num_gs..2 num_gs-1 the matured generation before it in the same
slots.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

Ints = npt.NDArray[np.int32]


class Lifespans:
    """Birth, start and expiry of both generations of every slot.

    During genesis all Gaussians live in [0, swin_size) and there is no matured generation.
    `stagger` ends genesis; afterwards `mature` hands over one slice a frame.
    """

    def __init__(self, num_gs: int, swin_size: int) -> None:
        self.num_gs = num_gs
        self.swin_size = swin_size
        self.slice_size = num_gs // swin_size
        self.births = np.zeros(num_gs, np.int32)
        self.starts = np.zeros(num_gs, np.int32)
        self.expires = np.full(num_gs, swin_size, np.int32)
        # An empty lifespan: no frame shows a matured generation yet.
        self.matured_starts = np.zeros(num_gs, np.int32)
        self.matured_expires = np.zeros(num_gs, np.int32)

    def stagger(self) -> None:
        """Ends genesis: the lanes live on for one frame more each.

        The slice that expires at e is as if born at e - swin_size, and lies in lane (e - swin_size)
        % swin_size.
        """
        for birth in range(1 - self.swin_size, 1):
            lane = self.lane_rows(birth % self.swin_size)
            self.births[lane] = birth
            self.starts[lane] = birth
            self.expires[lane] = birth + self.swin_size

    def move(self, frames: int) -> None:
        """Makes everything happen so many frames later."""
        for times in (self.births, self.starts, self.expires):
            times += frames
        self.matured_starts += frames
        self.matured_expires += frames

    def deal(self, ranking: npt.NDArray[np.int64]) -> npt.NDArray[np.int64]:
        """The order that puts the rows in `ranking` into lanes, the first slice into that which
        lives longest, each next one into that which lives a frame less. Row i becomes what row
        order[i] was."""
        order = np.empty(self.num_gs, np.int64)
        for rank in range(self.swin_size):
            lane = self.lane_rows(-rank % self.swin_size)
            order[lane] = ranking[rank * self.slice_size : (rank + 1) * self.slice_size]
        return order

    def lane_rows(self, lane: int) -> slice:
        return slice(lane * self.slice_size, (lane + 1) * self.slice_size)

    def due(self, first_frame: int) -> list[int]:
        """Births of the slices that no frame from `first_frame` on may change, oldest first."""
        return sorted({int(b) for b in self.births[:: self.slice_size] if b < first_frame})

    def mature(self, birth: int) -> slice:
        """Freezes the slice born at `birth` and begins the next generation of its slots.

        Gives the rows of its lane, whose parameters the caller copies to the matured rows, except
        those of kept slots.
        """
        rows = self.lane_rows(birth % self.swin_size)
        trained = ~self.kept(rows)
        self.matured_starts[rows][trained] = self.starts[rows][trained]
        self.matured_expires[rows][trained] = self.expires[rows][trained]
        self.births[rows] = self.expires[rows]
        self.starts[rows] = self.expires[rows]
        self.expires[rows] += self.swin_size
        return rows

    def keep(self, rows: slice) -> None:
        """Leases the slots `rows`, all of one lane whose new generation is not shown yet: what has
        matured in them goes on for another life."""
        self.starts[rows] = self.expires[rows]
        self.matured_expires[rows] = self.expires[rows]

    def take_up(self, rows: Ints) -> None:
        """Ends the leases of `rows`: their new generation shows from its birth on."""
        self.starts[rows] = self.births[rows]
        self.matured_expires[rows] = self.births[rows]

    def kept(self, rows: slice) -> npt.NDArray[np.bool_]:
        """Which of the slots `rows` are kept: their new generation never shows."""
        kept: npt.NDArray[np.bool_] = self.starts[rows] == self.expires[rows]
        return kept

    def active_rows(self, frame: int) -> Ints:
        """Rows of both generations that show at `frame`; trainable ones first."""
        current = np.flatnonzero((self.starts <= frame) & (frame < self.expires))
        matured = np.flatnonzero((self.matured_starts <= frame) & (frame < self.matured_expires))
        return np.concatenate([current, matured + self.num_gs]).astype(np.int32)

    def ages(self, first_frame: int) -> npt.NDArray[np.float32]:
        """(num_gs,) float32: windows that each row has been trained for before this one."""
        trained = first_frame + self.swin_size - 1 - self.starts
        return np.maximum(trained, 0).astype(np.float32)
