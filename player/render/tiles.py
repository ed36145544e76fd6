"""Which Gaussians touch which tile, front to back, and the blending of a tile's pixels."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from numba import prange

from codec.kernel import kernel

from .project import CONIC_A, CONIC_B, CONIC_C, Q_MAX, Projection, X, Y
from .recipe import ALPHA_MAX, ALPHA_MIN, TILE_PX, TRANSMITTANCE_MIN
from .sort import near_first

Floats = npt.NDArray[np.float32]
Ints = npt.NDArray[np.int32]

MARGIN_PX = np.float32(0.01)
"""What the exact tile test leaves for rounding."""


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
    order: Ints  # (tiles,) int32: tiles dealt so that equal shares of the list cost about the same


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
        return box[0], box[0]
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
    end = max(box[0], min(box[1], end))
    return min(max(box[0], first), end), end


@kernel(nogil=True, parallel=True)
def _row_spans(projected, boxes, row_starts, spans, pair_starts):  # type: ignore[no-untyped-def]
    """Fills spans (R, 2), Gaussian by Gaussian, row by row; pair_starts[i + 1]: pairs of i."""
    for i in prange(boxes.shape[0]):
        count = 0
        for y in range(boxes[i, 2], boxes[i, 3]):
            first, end = _row_span(projected, boxes[i], i, y)
            at = row_starts[i] + y - boxes[i, 2]
            spans[at, 0] = first
            spans[at, 1] = end
            count += end - first
        pair_starts[i + 1] = count


@kernel(nogil=True)
def _count_pairs(boxes, row_starts, spans, tiles_x, starts):  # type: ignore[no-untyped-def]
    """Fills starts (tiles + 1,) from the spans."""
    for i in range(boxes.shape[0]):
        at = row_starts[i]
        for y in range(boxes[i, 2], boxes[i, 3]):
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
        for y in range(boxes[i, 2], boxes[i, 3]):
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


def list_tiles(projection: Projection, tiles_x: int, tiles_y: int) -> TileLists:
    """Sorts the projected Gaussians by depth into the tiles that they reach."""
    boxes = projection.tile_boxes
    row_starts = np.zeros(len(boxes) + 1, np.int32)
    np.cumsum(boxes[:, 3] - boxes[:, 2], out=row_starts[1:])
    spans = np.empty((row_starts[-1], 2), np.int32)
    pair_starts = np.zeros(len(boxes) + 1, np.int32)
    _row_spans(projection.projected, boxes, row_starts, spans, pair_starts)
    np.cumsum(pair_starts, out=pair_starts)
    starts = np.zeros(tiles_x * tiles_y + 1, np.int32)
    _count_pairs(boxes, row_starts, spans, tiles_x, starts)
    gaussians, pairs = np.empty(pair_starts[-1], np.int32), np.empty(pair_starts[-1], np.int32)
    by_depth = near_first(projection.depths)
    _fill_pairs(boxes, row_starts, spans, by_depth, tiles_x, starts, pair_starts, gaussians, pairs)
    heavy_first = np.argsort(-np.diff(starts), kind="stable").astype(np.int32)
    # Threads take equal contiguous shares of the list: deal the tiles so that shares cost alike.
    shares = 8
    order = np.concatenate([heavy_first[s::shares] for s in range(shares)])
    return TileLists(starts, gaussians, pairs, pair_starts, order)


@kernel(fastmath=True, inline="always")
def exp_minus(q):  # type: ignore[no-untyped-def]
    """exp(-q) for 0 <= q <= 6, relative error below 1e-6; constant beyond, where nothing shows.

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
def row_misses(a, b, c, q_max, dy, left):  # type: ignore[no-untyped-def]
    """Whether the ellipse q <= q_max misses the 16 pixel centres of a row.

    dy: row centre minus Gaussian centre; left: first pixel centre minus Gaussian centre, px.
    """
    # a dx^2 + 2 b dx dy + c dy^2 <= 2 q_max, solved for dx
    root = b * b * dy * dy - a * (c * dy * dy - np.float32(2) * q_max)
    if root <= 0:
        return True
    root = np.sqrt(root)
    middle = -b * dy
    return (middle + root) < left * a or (middle - root) > (left + np.float32(15)) * a


@kernel(fastmath=True, parallel=True, nogil=True)
def blend_tiles(  # type: ignore[no-untyped-def]
    projected, starts, gaussians, order, tiles_x, picture
):
    """Blends every tile front to back into `picture` (3, tiles_y * 16, tiles_x * 16) float32."""
    size = TILE_PX
    alpha_min, alpha_max = np.float32(ALPHA_MIN), np.float32(ALPHA_MAX)
    stop = np.float32(TRANSMITTANCE_MIN)
    zero, half, one = np.float32(0), np.float32(0.5), np.float32(1)
    for k in prange(order.shape[0]):
        tile = order[k]
        x_px = (tile % tiles_x) * size
        y_px = (tile // tiles_x) * size
        # Per row of the tile: transmittance, red, green, blue, 16 pixels each. One buffer, so that
        # the compiler sees that the parts of a row do not overlap.
        pixels = np.zeros(size * 4 * size, np.float32)
        open_rows = size
        row_open = np.ones(size, np.bool_)
        for row in range(size):
            for x in range(size):
                pixels[row * 64 + x] = one
        for entry in range(starts[tile], starts[tile + 1]):
            g = gaussians[entry]
            cx, cy = projected[g, 0], projected[g, 1]
            a, b, c = projected[g, 2], projected[g, 3], projected[g, 4]
            opacity, q_max = projected[g, 5], projected[g, 9]
            red, green, blue = projected[g, 6], projected[g, 7], projected[g, 8]
            left = np.float32(x_px) + half - cx
            for row in range(size):
                dy = np.float32(y_px + row) + half - cy
                if not row_open[row] or row_misses(a, b, c, q_max, dy, left):
                    continue
                base = row * 64
                b_dy = b * dy
                c_dy = half * c * dy * dy
                half_a = half * a
                light = zero
                for x in range(16):
                    dx = left + np.float32(x)
                    q = (half_a * dx + b_dy) * dx + c_dy
                    alpha = min(alpha_max, opacity * exp_minus(q))
                    seen = pixels[base + x]
                    weight = seen * alpha
                    weight = weight if alpha >= alpha_min else zero
                    after = seen - weight
                    # A pixel that would pass the threshold ends here: zero transmittance marks it.
                    if after < stop:
                        weight = zero
                        after = zero
                    pixels[base + x] = after
                    pixels[base + 16 + x] += weight * red
                    pixels[base + 32 + x] += weight * green
                    pixels[base + 48 + x] += weight * blue
                    light += after  # a sum: a maximum would keep this loop out of vectors
                if light == zero:
                    row_open[row] = False
                    open_rows -= 1
            if open_rows == 0:
                break
        for row in range(size):
            for channel in range(3):
                for x in range(size):
                    picture[channel, y_px + row, x_px + x] = pixels[
                        row * 64 + 16 * (channel + 1) + x
                    ]
