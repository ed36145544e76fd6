"""Gradients of the blended picture with respect to the projected Gaussians.

The forward pass is repeated front to back, so nothing per pixel has to be kept from it. With g the
gradient of the loss for a pixel's colour, what lies behind a Gaussian enters through one number per
pixel, the remaining sum of weight * (colour . g), which starts at picture . g and shrinks on the
way.
"""

from __future__ import annotations

import numpy as np
from numba import prange

from codec.kernel import kernel
from player.render.recipe import ALPHA_MAX, ALPHA_MIN, TILE_PX, TRANSMITTANCE_MIN
from player.render.tiles import exp_minus, row_misses

# Columns of a pair's gradient.
G_X, G_Y, G_CONIC_A, G_CONIC_B, G_CONIC_C, G_LOGIT, G_RED, G_GREEN, G_BLUE = range(9)
PAIR_GRADIENT = 9

_ROW = 5 * TILE_PX  # per row of a tile: transmittance, remaining sum, g red, g green, g blue
_SUMS = TILE_PX * _ROW  # where the nine sums of 16 lanes each begin


@kernel(fastmath=True, parallel=True)
def blend_tiles_backward(  # type: ignore[no-untyped-def]
    projected, starts, gaussians, pairs, order, tiles_x, picture, picture_grad, pair_grads
):
    """Fills `pair_grads` (P, 9) float32 from `picture` and `picture_grad`, both (3, H16, W16)."""
    size = TILE_PX
    alpha_min, alpha_max = np.float32(ALPHA_MIN), np.float32(ALPHA_MAX)
    stop = np.float32(TRANSMITTANCE_MIN)
    zero, half, one = np.float32(0), np.float32(0.5), np.float32(1)
    for k in prange(order.shape[0]):
        tile = order[k]
        x_px = (tile % tiles_x) * size
        y_px = (tile // tiles_x) * size
        # One buffer for pixels and sums, so that the compiler sees that its parts do not overlap.
        buf = np.empty(_SUMS + 9 * 16, np.float32)
        for row in range(size):
            base = row * _ROW
            for x in range(size):
                red = picture_grad[0, y_px + row, x_px + x]
                green = picture_grad[1, y_px + row, x_px + x]
                blue = picture_grad[2, y_px + row, x_px + x]
                buf[base + x] = one
                buf[base + 16 + x] = (
                    red * picture[0, y_px + row, x_px + x]
                    + green * picture[1, y_px + row, x_px + x]
                    + blue * picture[2, y_px + row, x_px + x]
                )
                buf[base + 32 + x] = red
                buf[base + 48 + x] = green
                buf[base + 64 + x] = blue
        open_rows = size
        row_open = np.ones(size, np.bool_)
        for entry in range(starts[tile], starts[tile + 1]):
            pair = pairs[entry]
            if open_rows == 0:
                for column in range(PAIR_GRADIENT):
                    pair_grads[pair, column] = zero
                continue
            g = gaussians[entry]
            cx, cy = projected[g, 0], projected[g, 1]
            a, b, c = projected[g, 2], projected[g, 3], projected[g, 4]
            opacity, q_max = projected[g, 5], projected[g, 9]
            red, green, blue = projected[g, 6], projected[g, 7], projected[g, 8]
            left = np.float32(x_px) + half - cx
            for x in range(9 * 16):
                buf[_SUMS + x] = zero
            for row in range(size):
                dy = np.float32(y_px + row) + half - cy
                if not row_open[row] or row_misses(a, b, c, q_max, dy, left):
                    continue
                base = row * _ROW
                b_dy = b * dy
                c_dy = half * c * dy * dy
                half_a = half * a
                light = zero
                for x in range(16):
                    dx = left + np.float32(x)
                    q = (half_a * dx + b_dy) * dx + c_dy
                    free = opacity * exp_minus(q)
                    alpha = min(alpha_max, free)
                    seen = buf[base + x]
                    weight = seen * alpha
                    weight = weight if alpha >= alpha_min else zero
                    after = seen - weight
                    if after < stop:
                        weight = zero
                        after = zero
                    g_red, g_green, g_blue = (
                        buf[base + 32 + x],
                        buf[base + 48 + x],
                        buf[base + 64 + x],
                    )
                    along = red * g_red + green * g_green + blue * g_blue
                    behind = buf[base + 16 + x] - weight * along
                    # d loss / d alpha times alpha; none where alpha is cut or clamped
                    flow = (seen * along - behind / (one - alpha)) * alpha
                    flow = flow if weight > zero else zero
                    flow = flow if free <= alpha_max else zero
                    buf[base + x] = after
                    buf[base + 16 + x] = behind
                    light += after
                    flow_x = flow * dx
                    flow_y = flow * dy
                    buf[_SUMS + x] += flow
                    buf[_SUMS + 16 + x] += flow_x
                    buf[_SUMS + 32 + x] += flow_y
                    buf[_SUMS + 48 + x] += flow_x * dx
                    buf[_SUMS + 64 + x] += flow_x * dy
                    buf[_SUMS + 80 + x] += flow_y * dy
                    buf[_SUMS + 96 + x] += weight * g_red
                    buf[_SUMS + 112 + x] += weight * g_green
                    buf[_SUMS + 128 + x] += weight * g_blue
                if light == zero:
                    row_open[row] = False
                    open_rows -= 1
            flow, flow_x, flow_y, flow_xx, flow_xy, flow_yy = zero, zero, zero, zero, zero, zero
            sum_red, sum_green, sum_blue = zero, zero, zero
            for x in range(16):
                flow += buf[_SUMS + x]
                flow_x += buf[_SUMS + 16 + x]
                flow_y += buf[_SUMS + 32 + x]
                flow_xx += buf[_SUMS + 48 + x]
                flow_xy += buf[_SUMS + 64 + x]
                flow_yy += buf[_SUMS + 80 + x]
                sum_red += buf[_SUMS + 96 + x]
                sum_green += buf[_SUMS + 112 + x]
                sum_blue += buf[_SUMS + 128 + x]
            pair_grads[pair, 0] = a * flow_x + b * flow_y
            pair_grads[pair, 1] = b * flow_x + c * flow_y
            pair_grads[pair, 2] = -half * flow_xx
            pair_grads[pair, 3] = -flow_xy
            pair_grads[pair, 4] = -half * flow_yy
            pair_grads[pair, 5] = flow * (one - opacity)
            pair_grads[pair, 6] = sum_red
            pair_grads[pair, 7] = sum_green
            pair_grads[pair, 8] = sum_blue
