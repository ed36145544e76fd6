"""Renewal: where the newest frame shows what no Gaussian is near, unimportant Gaussians are placed.

Relocation draws its targets among living Gaussians, so what enters a scene, or moves further in a
frame than gradients reach, is found by luck only. Here pixels that are wrong are looked for in the
other cameras: the depth where most of them are wrong too, and show the same colours, is where
something is missing.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from numba import prange
from PIL import Image

from codec.camera import Camera
from codec.kernel import kernel
from codec.splats import Splats
from trainer.pictures.feed import Pictures
from trainer.pictures.scale import scaled_mask
from trainer.seed.gaussians import initial_splats
from trainer.seed.stereo import pair_cameras, small_camera, warped
from trainer.step.raster import Parameters, View, render
from trainer.step.weights import contribution

from .colour import CameraColour

Floats = npt.NDArray[np.float32]
Ints = npt.NDArray[np.int32]
Flags = npt.NDArray[np.bool_]

LEAST_ERROR = 0.05
"""Mean colour difference, of 1, from which on a pixel is wrong."""

DEPTHS = 64
"""Depths tried, evenly spaced in inverse depth, before the best is refined."""

FINER = 4
"""Steps on either side of the best depth, of a quarter each."""

COST_LIMIT = 0.2
"""Largest cost of a camera: what is hidden in one must not outvote the rest."""

COST_ACCEPTED = 0.06
"""Mean colour difference over the better half of the cameras, at which they see the same thing."""

SMALLEST_PX, LARGEST_PX = 0.5, 2.0
"""Bounds of a new Gaussian's standard deviation, in pixels of the small pictures."""


@dataclass(frozen=True, slots=True)
class Comparison:
    """One frame of all cameras, on small copies of their pictures."""

    cameras: tuple[Camera, ...]
    pictures: Floats  # (C, H, W, 3) float32, in the stream's colours; smaller ones fill a corner
    errors: Floats  # (C, H, W) float32, 0..1: how far off what is rendered is
    usable: Flags  # (C, H, W) whether all of a pixel's 3 x 3 neighbourhood counts


def _surrounded(counts: Flags) -> Flags:
    """(H - 2, W - 2): whether all of the 3 x 3 flags around each inner one are set."""
    rows = counts[:-2] & counts[1:-1] & counts[2:]
    return rows[:, :-2] & rows[:, 1:-1] & rows[:, 2:]


class Comparer:
    """Compares what is rendered with what the cameras saw, on small pictures."""

    def __init__(self, cameras: Sequence[Camera], near_m: float) -> None:
        self.views = [View.prepare(small_camera(c), near_m) for c in cameras]
        height = max(v.camera.height_px for v in self.views)
        width = max(v.camera.width_px for v in self.views)
        self._shape = len(self.views), height, width

    def compare(
        self, values: Parameters, rows: Ints, pictures: Pictures, frame: int, colour: CameraColour
    ) -> tuple[Comparison, Floats]:
        """The Gaussians `rows` against `frame`, and (M,) what each of them contributes there."""
        shown = np.zeros((*self._shape, 3), np.float32)
        errors = np.zeros(self._shape, np.float32)
        usable = np.zeros(self._shape, np.bool_)
        weights = np.zeros(len(rows), np.float32)
        for i, view in enumerate(self.views):
            width, height = size = view.camera.width_px, view.camera.height_px
            shot = pictures.shot(i, frame)
            small = Image.fromarray(shot.picture).resize(size, Image.Resampling.BOX)
            truth = np.asarray(small, np.float32) / np.float32(255)
            small_mask = None if shot.mask is None else scaled_mask(shot.mask, width, height)
            rendered = render(values, rows, view)
            weights += contribution(rendered, small_mask)
            # Compared as this camera would show it, matched with others in the stream's colours.
            gain, bias = colour.gain(i), colour.bias(i)
            seen = rendered.picture[:, :height, :width].transpose(1, 2, 0) * gain + bias
            errors[i, :height, :width] = np.abs(np.clip(seen, 0, 1) - truth).mean(axis=2)
            shown[i, :height, :width] = (truth - bias) / np.maximum(gain, np.float32(0.1))
            counts = np.ones((height, width), np.bool_) if small_mask is None else small_mask > 0
            usable[i, 1 : height - 1, 1 : width - 1] = _surrounded(counts)
        return Comparison(tuple(v.camera for v in self.views), shown, errors, usable), weights


@kernel(parallel=True, error_model="numpy")
def _find_depths(  # type: ignore[no-untyped-def]
    pictures, errors, usable, sizes, warps, offsets, neighbours, inverse_depths, which, xs, ys,
    finer, least, limit, depths, costs,
):  # fmt: skip
    """For pixel (xs[i], ys[i]) of camera which[i] fills depths[i] and costs[i], the lowest.

    A camera's cost is the mean difference of 3 x 3 pixels, or the limit where it is not wrong; the
    better half of the cameras that see a place counts. At pixels that are not usable a camera sees
    nothing.
    """
    count = neighbours.shape[1]
    step = inverse_depths[1] - inverse_depths[0]
    for i in prange(which.shape[0]):
        c, x, y = which[i], xs[i], ys[i]
        u, v = np.float32(x) + np.float32(0.5), np.float32(y) + np.float32(0.5)
        ordered = np.empty(count, np.float32)
        best, best_inverse = np.float32(np.inf), np.float32(0)
        coarse = inverse_depths.shape[0]
        middle = np.float32(0)
        for trial in range(coarse + 2 * finer + 1):
            if trial < coarse:
                inverse = inverse_depths[trial]
            else:
                if trial == coarse:
                    middle = best_inverse
                inverse = middle + step * np.float32(trial - coarse - finer) / np.float32(finer)
                # From near to far the inverse falls.
                inverse = min(max(inverse, inverse_depths[coarse - 1]), inverse_depths[0])
            depth = np.float32(1) / inverse
            seeing = 0
            for n in range(count):
                other = neighbours[c, n]
                px, py, w = warped(warps[c, n], offsets[c, n], depth, u, v)
                if w <= 0:
                    continue
                if not (0 <= px < sizes[other, 1] and 0 <= py < sizes[other, 0]):
                    continue
                ix, iy = np.int32(px), np.int32(py)
                if not usable[other, iy, ix]:
                    continue
                value = limit
                if errors[other, iy, ix] >= least:
                    total = np.float32(0)
                    for dy in range(-1, 2):
                        for dx in range(-1, 2):
                            for k in range(3):
                                total += abs(
                                    pictures[other, iy + dy, ix + dx, k]
                                    - pictures[c, y + dy, x + dx, k]
                                )
                    value = min(total / np.float32(27), limit)
                at = seeing
                while at > 0 and ordered[at - 1] > value:
                    ordered[at] = ordered[at - 1]
                    at -= 1
                ordered[at] = value
                seeing += 1
            if seeing < 2:
                continue
            keep = max(2, (seeing + 1) // 2)
            total = np.float32(0)
            for n in range(keep):
                total += ordered[n]
            total /= np.float32(keep)
            if total < best:
                best, best_inverse = total, inverse
        costs[i] = best
        depths[i] = np.float32(1) / best_inverse  # infinite where the costs are


def missing_splats(
    seen: Comparison,
    count: int,
    near_m: float,
    far_m: float,
    sh_degree: int,
    rng: np.random.Generator,
) -> Splats:
    """At most `count` Gaussians, in random order, where the cameras see what is not rendered."""
    cameras = seen.cameras
    weights = np.where(seen.usable & (seen.errors >= LEAST_ERROR), seen.errors, 0).reshape(-1)
    places = np.flatnonzero(weights)
    # Twice as many as wanted, as not all are found in other cameras.
    draws = min(2 * count, len(places))
    if draws == 0:
        return Splats.empty(sh_degree)
    chances = weights[places].astype(np.float64)
    drawn = rng.choice(places, draws, replace=False, p=chances / chances.sum())
    which, ys, xs = map(np.ascontiguousarray, np.unravel_index(drawn, seen.errors.shape))
    sizes = np.array([(c.height_px, c.width_px) for c in cameras], np.int32)
    neighbours, warps, offsets = pair_cameras(cameras)
    inverse_depths = np.linspace(1 / near_m, 1 / far_m, DEPTHS).astype(np.float32)
    depths = np.empty(len(drawn), np.float32)
    costs = np.empty(len(drawn), np.float32)
    _find_depths(
        seen.pictures, seen.errors, seen.usable, sizes, warps, offsets, neighbours,
        inverse_depths, which, xs, ys, FINER, np.float32(LEAST_ERROR / 2), np.float32(COST_LIMIT),
        depths, costs,
    )  # fmt: skip
    kept = np.flatnonzero(costs <= COST_ACCEPTED)[:count]
    which, xs, ys, depths = which[kept], xs[kept], ys[kept], depths[kept]
    positions = np.zeros((len(kept), 3), np.float32)
    pixel_m = np.zeros(len(kept), np.float32)
    for i, camera in enumerate(cameras):
        own = which == i
        positions[own] = camera.unproject(xs[own] + 0.5, ys[own] + 0.5, depths[own])
        pixel_m[own] = depths[own] / np.float32(camera.fx_px)
    colours = np.clip(seen.pictures[which, ys, xs] * 255, 0, 255).astype(np.uint8)
    splats = initial_splats(positions, colours, sh_degree)
    # Neighbours tell the size, within reason: cameras may find the same place twice.
    smallest, largest = (np.log(px * pixel_m)[:, None] for px in (SMALLEST_PX, LARGEST_PX))
    np.clip(splats.log_scales, smallest, largest, out=splats.log_scales)
    return splats
