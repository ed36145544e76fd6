"""How much each Gaussian adds to a picture: its blending weight, summed over the pixels."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from numba import prange

from codec.kernel import kernel
from player.render.recipe import ALPHA_MAX, ALPHA_MIN, TILE_PX, TRANSMITTANCE_MIN
from player.render.tiles import exp_minus, row_misses

from .raster import Rendered

Floats = npt.NDArray[np.float32]

_SUMS = TILE_PX * TILE_PX  # where the 16 lanes of a pair's sum begin, after the transmittances


@kernel(fastmath=True, parallel=True)
def sum_weights(  # type: ignore[no-untyped-def]
    projected, starts, gaussians, pairs, order, tiles_x, counts, pair_weights
):
    """Fills `pair_weights` (P,) float32 with the sum of transmittance * alpha over the pixels of
    each pair's tile that lie in the picture and count: counts (H, W) uint8, above 0."""
    height_px, width_px = counts.shape
    size = TILE_PX
    alpha_min, alpha_max = np.float32(ALPHA_MIN), np.float32(ALPHA_MAX)
    stop = np.float32(TRANSMITTANCE_MIN)
    zero, half, one = np.float32(0), np.float32(0.5), np.float32(1)
    for k in prange(order.shape[0]):
        tile = order[k]
        x_px = (tile % tiles_x) * size
        y_px = (tile // tiles_x) * size
        buf = np.zeros(_SUMS + size, np.float32)
        row_open = np.zeros(size, np.bool_)
        open_rows = 0
        for row in range(size):
            if y_px + row >= height_px:
                continue
            row_open[row] = True
            open_rows += 1
            for x in range(16):
                # Pixels beside the picture and ignored ones are closed from the start, so nothing
                # counts there.
                inside = x_px + x < width_px and counts[y_px + row, x_px + x] > 0
                buf[row * 16 + x] = one if inside else zero
        for entry in range(starts[tile], starts[tile + 1]):
            pair = pairs[entry]
            if open_rows == 0:
                pair_weights[pair] = zero
                continue
            g = gaussians[entry]
            cx, cy = projected[g, 0], projected[g, 1]
            a, b, c = projected[g, 2], projected[g, 3], projected[g, 4]
            opacity, q_max = projected[g, 5], projected[g, 9]
            left = np.float32(x_px) + half - cx
            for x in range(16):
                buf[_SUMS + x] = zero
            for row in range(size):
                dy = np.float32(y_px + row) + half - cy
                if not row_open[row] or row_misses(a, b, c, q_max, dy, left):
                    continue
                base = row * 16
                b_dy = b * dy
                c_dy = half * c * dy * dy
                half_a = half * a
                light = zero
                for x in range(16):
                    dx = left + np.float32(x)
                    q = (half_a * dx + b_dy) * dx + c_dy
                    alpha = min(alpha_max, opacity * exp_minus(q))
                    seen = buf[base + x]
                    weight = seen * alpha
                    weight = weight if alpha >= alpha_min else zero
                    after = seen - weight
                    if after < stop:
                        weight = zero
                        after = zero
                    buf[base + x] = after
                    buf[_SUMS + x] += weight
                    light += after
                if light == zero:
                    row_open[row] = False
                    open_rows -= 1
            total = zero
            for x in range(16):
                total += buf[_SUMS + x]
            pair_weights[pair] = total


def contribution(rendered: Rendered, mask: npt.NDArray[np.uint8] | None = None) -> Floats:
    """(M,) float32: the blending weight (transmittance * alpha) of each rendered Gaussian, summed
    over the pixels of the picture; pixels, so at most its area, and 0 for what does not show.
    mask: (H, W), above 0 where a pixel counts; None: all count.

    It is the derivative of the picture's sum by the Gaussian's colour.
    """
    lists, camera = rendered.lists, rendered.view.camera
    counts = np.ones((camera.height_px, camera.width_px), np.uint8) if mask is None else mask.copy()
    pair_weights = np.empty(len(lists.pairs), np.float32)
    sum_weights(
        rendered.projection.projected, lists.starts, lists.gaussians, lists.pairs, lists.order,
        rendered.view.tiles_x, counts, pair_weights,
    )  # fmt: skip
    # Pairs are numbered Gaussian by Gaussian: differences of a running sum, exact enough in double.
    running = np.concatenate([[0.0], np.cumsum(pair_weights, dtype=np.float64)])
    sums: Floats = np.diff(running[lists.pair_starts]).astype(np.float32)
    return sums
