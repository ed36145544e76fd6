"""Which tiles of a picture matter to what is trained."""

from __future__ import annotations

import numpy as np

from codec.arrays import Flags, Ints
from codec.kernel import kernel, prange
from player.render.blend import Reach, TileLists, dealt
from player.render.project import FIRST_Y, Projection


@kernel(parallel=True)
def _mark_tiles(boxes, row_starts, spans, moves, active):  # type: ignore[no-untyped-def]
    for i in prange(boxes.shape[0]):
        if not moves[i]:
            continue
        for at in range(row_starts[i], row_starts[i + 1]):
            y = boxes[i, FIRST_Y] + at - row_starts[i]
            for x in range(spans[at, 0], spans[at, 1]):
                # Threads that write what stands there would only slow each other down.
                if not active[y, x]:
                    active[y, x] = True


def active_tiles(
    projection: Projection, reach: Reach, moves: Flags, tiles_x: int, tiles_y: int
) -> Flags:
    """(tiles_y, tiles_x) bool: whether a tile holds a pair of a Gaussian that is trained.

    moves: (M,) bool, whether the Gaussian is.
    """
    active = np.zeros((tiles_y, tiles_x), np.bool_)
    _mark_tiles(projection.tile_boxes, reach.row_starts, reach.spans, moves, active)
    return active


def with_neighbours(tiles: Flags) -> Flags:
    """(tiles_y, tiles_x) bool: the tiles and their eight neighbours."""
    tall = tiles.copy()
    tall[1:] |= tiles[:-1]
    tall[:-1] |= tiles[1:]
    wide = tall.copy()
    wide[:, 1:] |= tall[:, :-1]
    wide[:, :-1] |= tall[:, 1:]
    return wide


@kernel(parallel=True)
def _find_ends(starts, gaussians, moves, ends):  # type: ignore[no-untyped-def]
    for tile in prange(ends.shape[0]):
        end = starts[tile + 1]
        while end > starts[tile] and not moves[gaussians[end - 1]]:
            end -= 1
        ends[tile] = end


def trained_ends(lists: TileLists, moves: Flags) -> tuple[Ints, Ints]:
    """(tiles,) int32: the entry after the last of a tile's list whose Gaussian is trained, or its
    first if there is none; and the tiles that have one, dealt as `dealt` does.

    moves: as for `active_tiles`.
    """
    ends = np.empty(len(lists.starts) - 1, np.int32)
    _find_ends(lists.starts, lists.gaussians, moves, ends)
    costs = ends - lists.starts[:-1]
    tiles = np.flatnonzero(costs).astype(np.int32)
    return ends, dealt(tiles, costs[tiles])
