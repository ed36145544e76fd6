"""Blending front to back: what one Gaussian does to one row of a tile's pixels.

Rule: the picture, its gradient and the contribution differ only in what they keep of a pixel. What
a Gaussian does to it stands here once. The compiler copies these functions into each of the three
loops, which stay vector code: a function for a whole row would have to pass the weights through
memory, and the contribution would take a quarter longer.
"""

from __future__ import annotations

import numpy as np

from codec.kernel import kernel, prange

from .project import BLUE, CONIC_A, CONIC_B, CONIC_C, GREEN, OPACITY, Q_MAX, RED, X, Y
from .recipe import ALPHA_MAX, ALPHA_MIN, TILE_PX, TRANSMITTANCE_MIN

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
