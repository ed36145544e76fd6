"""Which Gaussians touch which tile, front to back, and what each does to the pixels of a tile's
row.

Rule: the picture, its gradient and the contribution differ only in what they keep of a pixel. What
a Gaussian does to it stands here once. The compiler copies these functions into each of the three
loops, which stay vector code: a function for a whole row would have to pass the weights through
memory, and the contribution would take a quarter longer. The sort by depth is stable, so equal
depths have the same order on every machine.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from codec.arrays import Flags, Floats, Ints
from codec.kernel import kernel, prange

from .project import (
    ALPHA_MAX,
    ALPHA_MIN,
    BLUE,
    CONIC_A,
    CONIC_B,
    CONIC_C,
    END_X,
    END_Y,
    FIRST_X,
    FIRST_Y,
    GREEN,
    OPACITY,
    Q_MAX,
    RED,
    TILE_PX,
    TRANSMITTANCE_MIN,
    Projection,
    X,
    Y,
)


@kernel(nogil=True)
def radix_sort(keys, values, spare_keys, spare_values):  # type: ignore[no-untyped-def]
    """Sorts uint32 keys, and values with them, in ascending order, in three passes of 11 bits.

    The result is in the spare arrays; the others are overwritten. The bits of positive floats
    grow with their value, so their view as uint32 is an exact key.
    """
    counts = np.zeros((3, 2048), np.int32)
    for i in range(keys.shape[0]):
        key = keys[i]
        counts[0, key & 2047] += 1
        counts[1, (key >> 11) & 2047] += 1
        counts[2, key >> 22] += 1
    for digit in range(3):
        total = 0
        for value in range(2048):
            count = counts[digit, value]
            counts[digit, value] = total
            total += count
    for digit in range(3):
        shift = 11 * digit
        for i in range(keys.shape[0]):
            place = (keys[i] >> shift) & 2047
            to = counts[digit, place]
            counts[digit, place] = to + 1
            spare_keys[to] = keys[i]
            spare_values[to] = values[i]
        keys, spare_keys = spare_keys, keys
        values, spare_values = spare_values, values


def near_first(depths: Floats) -> Ints:
    """(M,) int32: the order of ascending depths (M,) float32; those below zero come last."""
    keys, order = depths.view(np.uint32).copy(), np.arange(len(depths), dtype=np.int32)
    spare_keys, spare_order = np.empty_like(keys), np.empty_like(order)
    radix_sort(keys, order, spare_keys, spare_order)
    return spare_order


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


# Planes of a row's pixels: transmittance, colour so far.
SEEN, PIXEL_RED, PIXEL_GREEN, PIXEL_BLUE = range(4)
PLANES = 4


@kernel(inline="always")
def tile_corner(tile, tiles_x):  # type: ignore[no-untyped-def]
    """x and y of the first pixel of tile number `tile`."""
    return (tile % tiles_x) * TILE_PX, (tile // tiles_x) * TILE_PX


@kernel(fastmath=True, inline="always")
def from_centre(at_px, centre_px):  # type: ignore[no-untyped-def]
    """Centre of pixel number `at_px` minus the Gaussian's centre, in x or in y, px."""
    return np.float32(at_px) + np.float32(0.5) - centre_px


@kernel(fastmath=True, inline="always")
def rows_hit(a, b, c, q_max, left, top):  # type: ignore[no-untyped-def]
    """First and end row of a tile whose pixel centres the ellipse q <= q_max reaches, but for some
    that it passes between; an ellipse reaches rows that lie side by side.

    left, top: centre of the tile's first pixel minus Gaussian centre, px. All rows at once: that is
    vector code, where a test and a branch for each row cost as much as blending.
    """
    first, count = np.int32(TILE_PX), np.int32(0)
    low, high = left * a, (left + np.float32(TILE_PX - 1)) * a
    for row in range(TILE_PX):
        dy = top + np.float32(row)
        root = b * b * dy * dy - a * (c * dy * dy - np.float32(2) * q_max)
        # a dx^2 + 2 b dx dy + c dy^2 <= 2 q_max, solved for dx: from the middle of what the
        # ellipse has of the row's line to the nearest place in the tile, times a.
        middle = -b * dy
        away = min(max(middle, low), high) - middle
        hit = root > away * away
        count += np.int32(hit)
        first = min(first, np.int32(row) if hit else np.int32(TILE_PX))
    return first, first + count


@kernel(fastmath=True, inline="always")
def exp_minus(q):  # type: ignore[no-untyped-def]
    """exp(-q) for 0 <= q <= 6, relative error below 2e-6; constant beyond, where nothing shows.

    A polynomial of q / 8, then three squarings: no table and no branch, so it stays in vectors.
    """
    t = min(q, np.float32(6)) * np.float32(-0.125)
    p = np.float32(9.49784813e-04)
    p = p * t + np.float32(7.89773333e-03)
    p = p * t + np.float32(4.14434430e-02)
    p = p * t + np.float32(1.66606608e-01)
    p = p * t + np.float32(4.99992159e-01)
    p = p * t + np.float32(9.99999608e-01)
    p = p * t + np.float32(1)
    p = p * p
    p = p * p
    return p * p


@kernel(fastmath=True, inline="always")
def unclamped_alpha(a, b, c, opacity, dx, dy):  # type: ignore[no-untyped-def]
    """opacity * exp(-q) for a pixel whose centre lies (dx, dy) px from the Gaussian's centre."""
    half = np.float32(0.5)
    q = (half * a * dx + b * dy) * dx + half * c * dy * dy
    return opacity * exp_minus(q)


@kernel(fastmath=True, inline="always")
def blend_pixel(seen, unclamped):  # type: ignore[no-untyped-def]
    """A Gaussian in front of a pixel: its alpha, its weight and the transmittance behind it.

    seen: transmittance in front of the Gaussian; unclamped: see `unclamped_alpha`.
    """
    alpha = min(np.float32(ALPHA_MAX), unclamped)
    weight = seen * alpha
    weight = weight if alpha >= np.float32(ALPHA_MIN) else np.float32(0)
    after = seen - weight
    # A pixel that would pass the threshold ends here: zero transmittance marks it.
    if after < np.float32(TRANSMITTANCE_MIN):
        weight = np.float32(0)
        after = np.float32(0)
    return alpha, weight, after


@kernel(fastmath=True, parallel=True, nogil=True)
def blend_tiles(  # type: ignore[no-untyped-def]
    projected, starts, gaussians, order, tiles_x, picture
):
    """Blends every tile front to back into `picture`, float32,
    (3, tiles_y * TILE_PX, tiles_x * TILE_PX). A fourth plane of it gets the alpha."""
    zero = np.float32(0)
    for k in prange(order.shape[0]):
        tile = order[k]
        x_px, y_px = tile_corner(tile, tiles_x)
        pixels = np.zeros((TILE_PX, PLANES, TILE_PX), np.float32)
        open_rows = TILE_PX
        row_open = np.ones(TILE_PX, np.bool_)
        for row in range(TILE_PX):
            for x in range(TILE_PX):
                pixels[row, SEEN, x] = np.float32(1)
        for entry in range(starts[tile], starts[tile + 1]):
            g = gaussians[entry]
            a, b, c = projected[g, CONIC_A], projected[g, CONIC_B], projected[g, CONIC_C]
            opacity, q_max = projected[g, OPACITY], projected[g, Q_MAX]
            red, green, blue = projected[g, RED], projected[g, GREEN], projected[g, BLUE]
            left, top = from_centre(x_px, projected[g, X]), from_centre(y_px, projected[g, Y])
            first, end = rows_hit(a, b, c, q_max, left, top)
            for row in range(first, end):
                if not row_open[row]:
                    continue
                dy = top + np.float32(row)
                light = zero
                for x in range(TILE_PX):
                    unclamped = unclamped_alpha(a, b, c, opacity, left + np.float32(x), dy)
                    _, weight, after = blend_pixel(pixels[row, SEEN, x], unclamped)
                    pixels[row, SEEN, x] = after
                    pixels[row, PIXEL_RED, x] += weight * red
                    pixels[row, PIXEL_GREEN, x] += weight * green
                    pixels[row, PIXEL_BLUE, x] += weight * blue
                    light += after  # a sum: a maximum would keep this loop out of vectors
                if light == zero:
                    row_open[row] = False
                    open_rows -= 1
            if open_rows == 0:
                break
        for row in range(TILE_PX):
            for channel in range(3):
                for x in range(TILE_PX):
                    picture[channel, y_px + row, x_px + x] = pixels[row, PIXEL_RED + channel, x]
            for channel in range(3, picture.shape[0]):
                for x in range(TILE_PX):
                    picture[channel, y_px + row, x_px + x] = np.float32(1) - pixels[row, SEEN, x]
