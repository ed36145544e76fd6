"""Gradients of the blended picture with respect to the projected Gaussians.

The forward pass is repeated front to back, so nothing per pixel has to be kept from it. With d the
gradient of the loss for a pixel's colour, what lies behind a Gaussian enters through one number per
pixel, the remaining sum of weight * (colour . d), which starts at picture . d and shrinks on the
way.
"""

from __future__ import annotations

import numpy as np

from codec.kernel import kernel, prange
from player.render.blend import (
    blend_pixel,
    from_centre,
    rows_hit,
    tile_corner,
    unclamped_alpha,
)
from player.render.project import (
    BLUE,
    CONIC_A,
    CONIC_B,
    CONIC_C,
    GREEN,
    OPACITY,
    Q_MAX,
    RED,
    X,
    Y,
)
from player.render.recipe import ALPHA_MAX, TILE_PX

# Columns of a pair's gradient, named after what it is for.
G_X, G_Y, G_CONIC_A, G_CONIC_B, G_CONIC_C, G_LOGIT, G_RED, G_GREEN, G_BLUE = range(9)
PAIR_GRADIENT = 9

# Planes of a row's pixels: transmittance, remaining sum, d.
SEEN, BEHIND, D_RED, D_GREEN, D_BLUE = range(5)
PLANES = 5

# Sums over the rows of a tile for one pair, a lane for each column of pixels: `flow` times powers
# of the offset from the Gaussian's centre, weight times d.
FLOW, FLOW_X, FLOW_Y, FLOW_XX, FLOW_XY, FLOW_YY, SUM_RED, SUM_GREEN, SUM_BLUE = range(9)
SUMS = 9


@kernel(fastmath=True, inline="always")
def _pass_frozen(projected, g, x_px, y_px, pixels, row_open, open_rows):  # type: ignore[no-untyped-def]
    """Puts Gaussian g before what is left of a tile, without a gradient; the rows still open."""
    zero = np.float32(0)
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
            along = (
                red * pixels[row, D_RED, x]
                + green * pixels[row, D_GREEN, x]
                + blue * pixels[row, D_BLUE, x]
            )
            pixels[row, SEEN, x] = after
            pixels[row, BEHIND, x] -= weight * along
            light += after
        if light == zero:
            row_open[row] = False
            open_rows -= 1
    return open_rows


@kernel(fastmath=True, parallel=True)
def blend_tiles_backward(  # type: ignore[no-untyped-def]
    projected,
    starts,
    ends,
    gaussians,
    pairs,
    moves,
    order,
    tiles_x,
    picture,
    picture_grad,
    pair_grads,
):
    """Fills `pair_grads` (P, 9) float32 from `picture` and `picture_grad`, both
    (3, tiles_y * TILE_PX, tiles_x * TILE_PX), for the pairs of Gaussians that are trained.

    moves: (M,) bool, whether a Gaussian is. ends, order: see `trained_ends`; a tile's list is gone
    through up to its end, as what is frozen hides what lies behind it all the same.
    """
    alpha_max = np.float32(ALPHA_MAX)
    zero, half, one = np.float32(0), np.float32(0.5), np.float32(1)
    for k in prange(order.shape[0]):
        tile = order[k]
        x_px, y_px = tile_corner(tile, tiles_x)
        pixels = np.empty((TILE_PX, PLANES, TILE_PX), np.float32)
        sums = np.empty((SUMS, TILE_PX), np.float32)
        for row in range(TILE_PX):
            for x in range(TILE_PX):
                red = picture_grad[0, y_px + row, x_px + x]
                green = picture_grad[1, y_px + row, x_px + x]
                blue = picture_grad[2, y_px + row, x_px + x]
                pixels[row, SEEN, x] = one
                pixels[row, BEHIND, x] = (
                    red * picture[0, y_px + row, x_px + x]
                    + green * picture[1, y_px + row, x_px + x]
                    + blue * picture[2, y_px + row, x_px + x]
                )
                pixels[row, D_RED, x] = red
                pixels[row, D_GREEN, x] = green
                pixels[row, D_BLUE, x] = blue
        open_rows = TILE_PX
        row_open = np.ones(TILE_PX, np.bool_)
        for entry in range(starts[tile], ends[tile]):
            pair = pairs[entry]
            g = gaussians[entry]
            if not moves[g]:
                if open_rows > 0:
                    open_rows = _pass_frozen(projected, g, x_px, y_px, pixels, row_open, open_rows)
                continue
            if open_rows == 0:
                for column in range(PAIR_GRADIENT):
                    pair_grads[pair, column] = zero
                continue
            a, b, c = projected[g, CONIC_A], projected[g, CONIC_B], projected[g, CONIC_C]
            opacity, q_max = projected[g, OPACITY], projected[g, Q_MAX]
            red, green, blue = projected[g, RED], projected[g, GREEN], projected[g, BLUE]
            left, top = from_centre(x_px, projected[g, X]), from_centre(y_px, projected[g, Y])
            for plane in range(SUMS):
                for x in range(TILE_PX):
                    sums[plane, x] = zero
            first, end = rows_hit(a, b, c, q_max, left, top)
            for row in range(first, end):
                if not row_open[row]:
                    continue
                dy = top + np.float32(row)
                light = zero
                for x in range(TILE_PX):
                    dx = left + np.float32(x)
                    unclamped = unclamped_alpha(a, b, c, opacity, dx, dy)
                    seen = pixels[row, SEEN, x]
                    alpha, weight, after = blend_pixel(seen, unclamped)
                    d_red = pixels[row, D_RED, x]
                    d_green = pixels[row, D_GREEN, x]
                    d_blue = pixels[row, D_BLUE, x]
                    along = red * d_red + green * d_green + blue * d_blue
                    behind = pixels[row, BEHIND, x] - weight * along
                    # d loss / d alpha times alpha; none where alpha is cut or clamped
                    flow = (seen * along - behind / (one - alpha)) * alpha
                    flow = flow if weight > zero else zero
                    flow = flow if unclamped <= alpha_max else zero
                    pixels[row, SEEN, x] = after
                    pixels[row, BEHIND, x] = behind
                    light += after
                    flow_x = flow * dx
                    flow_y = flow * dy
                    sums[FLOW, x] += flow
                    sums[FLOW_X, x] += flow_x
                    sums[FLOW_Y, x] += flow_y
                    sums[FLOW_XX, x] += flow_x * dx
                    sums[FLOW_XY, x] += flow_x * dy
                    sums[FLOW_YY, x] += flow_y * dy
                    sums[SUM_RED, x] += weight * d_red
                    sums[SUM_GREEN, x] += weight * d_green
                    sums[SUM_BLUE, x] += weight * d_blue
                if light == zero:
                    row_open[row] = False
                    open_rows -= 1
            flow, flow_x, flow_y, flow_xx, flow_xy, flow_yy = zero, zero, zero, zero, zero, zero
            sum_red, sum_green, sum_blue = zero, zero, zero
            for x in range(TILE_PX):
                flow += sums[FLOW, x]
                flow_x += sums[FLOW_X, x]
                flow_y += sums[FLOW_Y, x]
                flow_xx += sums[FLOW_XX, x]
                flow_xy += sums[FLOW_XY, x]
                flow_yy += sums[FLOW_YY, x]
                sum_red += sums[SUM_RED, x]
                sum_green += sums[SUM_GREEN, x]
                sum_blue += sums[SUM_BLUE, x]
            pair_grads[pair, G_X] = a * flow_x + b * flow_y
            pair_grads[pair, G_Y] = b * flow_x + c * flow_y
            pair_grads[pair, G_CONIC_A] = -half * flow_xx
            pair_grads[pair, G_CONIC_B] = -flow_xy
            pair_grads[pair, G_CONIC_C] = -half * flow_yy
            pair_grads[pair, G_LOGIT] = flow * (one - opacity)
            pair_grads[pair, G_RED] = sum_red
            pair_grads[pair, G_GREEN] = sum_green
            pair_grads[pair, G_BLUE] = sum_blue
