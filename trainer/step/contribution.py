"""The contribution of each Gaussian: its blending weight, summed over the pixels of pictures."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from codec.arrays import Doubles, Floats, Ints
from codec.kernel import kernel, prange
from player.render.blend import blend_pixel, from_centre, rows_hit, tile_corner, unclamped_alpha
from player.render.project import CONIC_A, CONIC_B, CONIC_C, OPACITY, Q_MAX, TILE_PX, X, Y
from trainer.capture.capture import Mask

from .raster import Parameters, Rendered, View, render


@kernel(fastmath=True, parallel=True)
def sum_weights(  # type: ignore[no-untyped-def]
    projected, starts, gaussians, pairs, order, tiles_x, counts, pair_weights
):
    """Fills `pair_weights` (P,) float32 with the sum of transmittance * alpha over the pixels of
    each pair's tile that lie in the picture and count: counts (H, W) uint8, above 0."""
    height_px, width_px = counts.shape
    zero, one = np.float32(0), np.float32(1)
    for k in prange(order.shape[0]):
        tile = order[k]
        x_px, y_px = tile_corner(tile, tiles_x)
        seen = np.zeros((TILE_PX, TILE_PX), np.float32)
        sums = np.empty(TILE_PX, np.float32)
        row_open = np.zeros(TILE_PX, np.bool_)
        open_rows = 0
        for row in range(TILE_PX):
            if y_px + row >= height_px:
                continue
            row_open[row] = True
            open_rows += 1
            for x in range(TILE_PX):
                # Pixels beside the picture and ignored ones are closed from the start, so nothing
                # counts there.
                inside = x_px + x < width_px and counts[y_px + row, x_px + x] > 0
                seen[row, x] = one if inside else zero
        for entry in range(starts[tile], starts[tile + 1]):
            pair = pairs[entry]
            if open_rows == 0:
                pair_weights[pair] = zero
                continue
            g = gaussians[entry]
            a, b, c = projected[g, CONIC_A], projected[g, CONIC_B], projected[g, CONIC_C]
            opacity, q_max = projected[g, OPACITY], projected[g, Q_MAX]
            left, top = from_centre(x_px, projected[g, X]), from_centre(y_px, projected[g, Y])
            for x in range(TILE_PX):
                sums[x] = zero
            first, end = rows_hit(a, b, c, q_max, left, top)
            for row in range(first, end):
                if not row_open[row]:
                    continue
                dy = top + np.float32(row)
                light = zero
                for x in range(TILE_PX):
                    unclamped = unclamped_alpha(a, b, c, opacity, left + np.float32(x), dy)
                    _, weight, after = blend_pixel(seen[row, x], unclamped)
                    seen[row, x] = after
                    sums[x] += weight
                    light += after
                if light == zero:
                    row_open[row] = False
                    open_rows -= 1
            total = zero
            for x in range(TILE_PX):
                total += sums[x]
            pair_weights[pair] = total


def contribution(rendered: Rendered, mask: Mask | None = None) -> Floats:
    """(M,) float32: the blending weight (transmittance * alpha) of each rendered Gaussian, summed
    over the pixels of the picture; pixels, so at most its area, and 0 for what does not show.
    mask: (H, W); None: all pixels count.

    It is the derivative of the picture's sum by the Gaussian's colour.
    """
    lists, camera = rendered.lists, rendered.view.camera
    # A copy, as numba compiles anew for arrays that may not be written to.
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


def summed_contribution(
    values: Parameters, rows: Ints, views: Sequence[View], masks: Sequence[Mask | None]
) -> Doubles:
    """(M,) float64: what each of the Gaussians `rows`, which are all that is shown, contributes to
    the pictures of `views` together. masks: one for each view."""
    sums = np.zeros(len(rows), np.float64)
    for view, mask in zip(views, masks, strict=True):
        sums += contribution(render(values, rows, view), mask)
    return sums
