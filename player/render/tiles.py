"""Which Gaussians touch which tile, front to back."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from codec.arrays import Flags, Ints
from codec.kernel import kernel, prange

from .project import (
    CONIC_A,
    CONIC_B,
    CONIC_C,
    END_X,
    END_Y,
    FIRST_X,
    FIRST_Y,
    Q_MAX,
    Projection,
    X,
    Y,
)
from .recipe import TILE_PX
from .sort import near_first

MARGIN_PX = np.float32(0.01)
"""Margin of the exact tile test, for rounding."""


@dataclass(frozen=True, slots=True)
class TileLists:
    """For every tile its Gaussians from front to back.

    A pair is one Gaussian in one tile. Pairs are numbered Gaussian by Gaussian, so that whatever
    the tiles compute for their pairs can be summed per Gaussian from one contiguous run, in a
    fixed order.
    """

    starts: Ints  # (tiles + 1,) int32: tile t owns entries starts[t]:starts[t + 1]
    gaussians: Ints  # (P,) int32: index into the projection
    pairs: Ints  # (P,) int32: number of the pair
    pair_starts: Ints  # (M + 1,) int32: Gaussian i owns pairs pair_starts[i]:pair_starts[i + 1]
    order: Ints  # (T,) int32: the tiles to draw, all or those wanted, dealt as `dealt` does


@dataclass(frozen=True, slots=True)
class Reach:
    """Which tiles each of M projected Gaussians reaches, row by row of its box of tiles."""

    row_starts: Ints  # (M + 1,) int32: Gaussian i owns spans row_starts[i]:row_starts[i + 1]
    spans: Ints  # (S, 2) int32: in a row of tiles the first in x, and the one after the last
    pair_starts: Ints  # see TileLists


@kernel(nogil=True, inline="always")
def _row_span(projected, box, i, y):  # type: ignore[no-untyped-def]
    """First and end tile of row y of tiles that Gaussian i's ellipse q <= q_max reaches.

    The exact tile test of Speedy-Splat (AccuTile): over the band of a row's pixel centres an
    ellipse is widest where its own rightmost and leftmost points are, or at the band's end nearest
    to them.
    """
    a, b, c = projected[i, CONIC_A], projected[i, CONIC_B], projected[i, CONIC_C]
    top = np.float32(y * TILE_PX) + np.float32(0.5) - projected[i, Y] - MARGIN_PX
    bottom = top + np.float32(TILE_PX - 1) + np.float32(2) * MARGIN_PX
    reach = np.float32(2) * projected[i, Q_MAX]
    det = a * c - b * b
    tallest = np.sqrt(a * reach / det)
    top, bottom = max(top, -tallest), min(bottom, tallest)
    if top > bottom:
        return box[FIRST_X], box[FIRST_X]
    # The rightmost point lies at height `turn`, the leftmost at -turn.
    turn = -b * np.sqrt(reach / (c * det))
    right_y = min(max(turn, top), bottom)
    left_y = min(max(-turn, top), bottom)
    right_root = np.sqrt(max(a * reach - det * right_y * right_y, np.float32(0)))
    left_root = np.sqrt(max(a * reach - det * left_y * left_y, np.float32(0)))
    right = projected[i, X] + (right_root - b * right_y) / a + MARGIN_PX
    left = projected[i, X] - (left_root + b * left_y) / a - MARGIN_PX
    # A tile's pixel centres begin half a pixel inside it and end half a pixel before the next.
    first = np.int32(np.ceil((left + np.float32(0.5)) / np.float32(TILE_PX))) - 1
    end = np.int32(np.floor((right - np.float32(0.5)) / np.float32(TILE_PX))) + 1
    end = max(box[FIRST_X], min(box[END_X], end))
    return min(max(box[FIRST_X], first), end), end


@kernel(nogil=True, parallel=True)
def _row_spans(projected, boxes, row_starts, spans, pair_starts):  # type: ignore[no-untyped-def]
    """Fills spans (R, 2), Gaussian by Gaussian, row by row; pair_starts[i + 1]: pairs of i."""
    for i in prange(boxes.shape[0]):
        count = 0
        for y in range(boxes[i, FIRST_Y], boxes[i, END_Y]):
            first, end = _row_span(projected, boxes[i], i, y)
            at = row_starts[i] + y - boxes[i, FIRST_Y]
            spans[at, 0] = first
            spans[at, 1] = end
            count += end - first
        pair_starts[i + 1] = count


@kernel(nogil=True, parallel=True)
def _trim_spans(boxes, row_starts, given, wanted, spans, pair_starts):  # type: ignore[no-untyped-def]
    """Fills `spans` and `pair_starts` as _row_spans does, with the given spans from their first
    wanted tile to their last."""
    for i in prange(boxes.shape[0]):
        count = 0
        for at in range(row_starts[i], row_starts[i + 1]):
            y = boxes[i, FIRST_Y] + at - row_starts[i]
            first, end = given[at, 0], given[at, 1]
            while first < end and not wanted[y, first]:
                first += 1
            while first < end and not wanted[y, end - 1]:
                end -= 1
            spans[at, 0] = first
            spans[at, 1] = end
            count += end - first
        pair_starts[i + 1] = count


@kernel(nogil=True)
def _count_pairs(boxes, row_starts, spans, tiles_x, starts):  # type: ignore[no-untyped-def]
    """Fills starts (tiles + 1,) from the spans."""
    for i in range(boxes.shape[0]):
        at = row_starts[i]
        for y in range(boxes[i, FIRST_Y], boxes[i, END_Y]):
            for x in range(spans[at, 0], spans[at, 1]):
                starts[y * tiles_x + x + 1] += 1
            at += 1
    for t in range(starts.shape[0] - 1):
        starts[t + 1] += starts[t]


@kernel(nogil=True)
def _fill_pairs(  # type: ignore[no-untyped-def]
    boxes, row_starts, spans, order, tiles_x, starts, pair_starts, gaussians, pairs
):
    cursor = starts[:-1].copy()
    for i in order:
        pair = pair_starts[i]
        at = row_starts[i]
        for y in range(boxes[i, FIRST_Y], boxes[i, END_Y]):
            for x in range(spans[at, 0], spans[at, 1]):
                place = cursor[y * tiles_x + x]
                gaussians[place] = i
                pairs[place] = pair
                cursor[y * tiles_x + x] = place + 1
                pair += 1
            at += 1


def tile_grid(width_px: int, height_px: int) -> tuple[int, int]:
    """Tiles in x and in y that cover the picture."""
    return -(-width_px // TILE_PX), -(-height_px // TILE_PX)


def reach_of(projection: Projection) -> Reach:
    """The tiles that each projected Gaussian reaches."""
    boxes = projection.tile_boxes
    row_starts = np.zeros(len(boxes) + 1, np.int32)
    np.cumsum(boxes[:, END_Y] - boxes[:, FIRST_Y], out=row_starts[1:])
    spans = np.empty((row_starts[-1], 2), np.int32)
    pair_starts = np.zeros(len(boxes) + 1, np.int32)
    _row_spans(projection.projected, boxes, row_starts, spans, pair_starts)
    np.cumsum(pair_starts, out=pair_starts)
    return Reach(row_starts, spans, pair_starts)


def trimmed(reach: Reach, projection: Projection, wanted: Flags) -> Reach:
    """`reach` without the tiles before the first wanted one of a span and after the last.

    wanted: (tiles_y, tiles_x) bool.
    """
    spans, pair_starts = np.empty_like(reach.spans), np.zeros_like(reach.pair_starts)
    _trim_spans(projection.tile_boxes, reach.row_starts, reach.spans, wanted, spans, pair_starts)
    np.cumsum(pair_starts, out=pair_starts)
    return Reach(reach.row_starts, spans, pair_starts)


def dealt(tiles: Ints, costs: Ints) -> Ints:
    """(T,) int32: `tiles` in an order in which equal shares cost about the same.

    Threads take equal contiguous shares of a list. costs: (T,) int32, of any unit.
    """
    heavy_first = tiles[np.argsort(-costs, kind="stable")]
    shares = 8
    return np.concatenate([heavy_first[s::shares] for s in range(shares)])


def list_tiles(
    projection: Projection,
    tiles_x: int,
    tiles_y: int,
    reach: Reach | None = None,
    wanted: Flags | None = None,
) -> TileLists:
    """Sorts the projected Gaussians by depth into the tiles that they reach.

    reach: of the projection, where it is known. wanted: (tiles_y, tiles_x) bool, the tiles to draw;
    what reaches none of them is left out, and the lists of others are not complete. None: all.
    """
    boxes = projection.tile_boxes
    reach = reach or reach_of(projection)
    if wanted is not None:
        reach = trimmed(reach, projection, wanted)
    row_starts, spans, pair_starts = reach.row_starts, reach.spans, reach.pair_starts
    starts = np.zeros(tiles_x * tiles_y + 1, np.int32)
    _count_pairs(boxes, row_starts, spans, tiles_x, starts)
    gaussians, pairs = np.empty(pair_starts[-1], np.int32), np.empty(pair_starts[-1], np.int32)
    drawn = np.ones(tiles_x * tiles_y, np.bool_) if wanted is None else wanted
    tiles = np.flatnonzero(drawn).astype(np.int32)
    listed = np.flatnonzero(np.diff(pair_starts)).astype(np.int32)
    by_depth = listed[near_first(projection.depths[listed])]
    _fill_pairs(boxes, row_starts, spans, by_depth, tiles_x, starts, pair_starts, gaussians, pairs)
    order = dealt(tiles, np.diff(starts)[tiles])
    return TileLists(starts, gaussians, pairs, pair_starts, order)
