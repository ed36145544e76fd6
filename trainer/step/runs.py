"""Which pixels of a picture a step looks at, as runs along its rows."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from codec.arrays import Flags, Ints
from codec.kernel import kernel
from player.render.project import TILE_PX

VECTOR_PX = 8
"""Floats that a processor handles at a time, or half of them."""


@dataclass(frozen=True, slots=True)
class Runs:
    """Pixels of a picture of height H, row by row."""

    rows: Ints  # (R,) int32: the rows that have a run, ascending
    starts: Ints  # (H + 1,) int32: row y owns runs starts[y]:starts[y + 1]
    bounds: Ints  # (S, 2) int32: first column of a run and the one after its last, px

    @staticmethod
    def whole(height: int, width: int) -> Runs:
        """All of a picture: one run a row."""
        rows = np.arange(height + 1, dtype=np.int32)
        return Runs(rows[:-1].copy(), rows, np.full((height, 2), (0, width), np.int32))

    @staticmethod
    def around(active: Flags, reach_x: int, reach_y: int, height: int, width: int) -> Runs:
        """The pixels of the active tiles, and those up to reach_x and reach_y px beside them.

        active: (tiles_y, tiles_x) bool.
        """
        rows, starts = np.empty(height, np.int32), np.empty(height + 1, np.int32)
        bounds = np.empty((height * (active.shape[1] // 2 + 1), 2), np.int32)
        row_count = _find_runs(active, reach_x, reach_y, width, rows, starts, bounds)
        return Runs(rows[:row_count], starts, bounds[: starts[-1]])

    @property
    def arrays(self) -> tuple[Ints, Ints, Ints]:
        """As kernels take them."""
        return self.rows, self.starts, self.bounds

    @property
    def pixels(self) -> int:
        """How many there are."""
        return int((self.bounds[:, 1] - self.bounds[:, 0]).sum())


@dataclass(frozen=True, slots=True)
class Looked:
    """Where each stage of the loss looks, so that its gradient is right on some pixels, its own."""

    picture: Runs  # the pictures themselves
    products: Runs  # their products, blurred along x
    similarity: Runs  # the same blurred along y as well, and the partial derivatives of SSIM
    partials: Runs  # those blurred along x
    own: Runs

    @staticmethod
    def whole(height: int, width: int) -> Looked:
        """All stages at all of a picture."""
        return Looked(*[Runs.whole(height, width)] * 5)

    @staticmethod
    def at(active: Flags, radius_px: int, height: int, width: int) -> Looked:
        """Own: the active tiles. A blur reaches radius_px, first the products', then the partials';
        along x that is rounded up to whole vectors."""
        reach_x, size = -(-radius_px // VECTOR_PX) * VECTOR_PX, (height, width)
        return Looked(
            Runs.around(active, 2 * reach_x, 2 * radius_px, *size),
            Runs.around(active, reach_x, 2 * radius_px, *size),
            Runs.around(active, reach_x, radius_px, *size),
            Runs.around(active, 0, radius_px, *size),
            Runs.around(active, 0, 0, *size),
        )


@kernel()
def _find_runs(active, reach_x, reach_y, width, rows, starts, bounds):  # type: ignore[no-untyped-def]
    """Fills the arrays of Runs; the number of rows that have a run."""
    height, row_count, count = rows.shape[0], 0, 0
    starts[0] = 0
    for y in range(height):
        first_tile = max(y - reach_y, 0) // TILE_PX
        last_tile = min(y + reach_y, height - 1) // TILE_PX
        for tile in range(active.shape[1]):
            near = False
            for tile_y in range(first_tile, last_tile + 1):
                near = near or active[tile_y, tile]
            if not near:
                continue
            first = max(tile * TILE_PX - reach_x, 0)
            end = min((tile + 1) * TILE_PX + reach_x, width)
            if count > starts[y] and first <= bounds[count - 1, 1]:
                bounds[count - 1, 1] = end
            else:
                bounds[count, 0] = first
                bounds[count, 1] = end
                count += 1
        starts[y + 1] = count
        if count > starts[y]:
            rows[row_count] = y
            row_count += 1
    return row_count
