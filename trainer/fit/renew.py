"""Renewal: where the newest frame shows what no Gaussian renders, unimportant ones are placed.

Relocation moves Gaussians to where others live, so what enters a scene, or moves further in a frame
than gradients reach, is found by luck only. Here each wrong pixel is looked for in the other
cameras, depth by depth: where most of them are wrong too and show the same colours, something is
missing.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from PIL import Image

from codec.arrays import Doubles, Flags, Floats, Ints, Longs
from codec.camera import Camera
from codec.kernel import kernel, prange
from codec.splats import Splats
from player.render.project import TILE_PX
from trainer.pictures.framecache import Pictures
from trainer.pictures.scale import scaled_mask
from trainer.seed.gaussians import initial_splats
from trainer.seed.stereo import (
    better_half,
    pair_cameras,
    small_camera,
    tried_inverse_depths,
    warped,
)
from trainer.step.colour import CameraColour
from trainer.step.contribution import contribution
from trainer.step.raster import Parameters, Rendered, View, render, weighed

LEAST_ERROR = 0.05
"""Mean colour difference, of 1, from which on a pixel is wrong. In the other cameras half of it is
enough."""

LEAST_CHANGE = 3e-4
"""Squared colour difference that may come from noise."""

ERROR_WEIGHT = 0.03
"""Weight of the error of pixels that did not change, beside those that did."""

FINER = 4
"""Finer steps tried to either side of the best of stereo's depths; together one of its steps."""

COST_LIMIT = 0.2
"""Largest cost of a camera, of 1: one that something hides the place from must not outvote the
rest."""

COST_ACCEPTED = 0.06
"""Largest mean cost of the better half of the cameras at which they see the same thing."""

SMALLEST_PX, LARGEST_PX = 0.5, 2.0
"""Bounds of a new Gaussian's standard deviation, in pixels of the small pictures."""


def _smoothed(differences: Floats) -> Floats:
    """(H, W, 3): means over 3 x 3 pixels; beyond the border the nearest pixel counts again."""
    padded = np.pad(differences, ((1, 1), (1, 1), (0, 0)), mode="edge")
    rows = padded[:-2] + padded[1:-1] + padded[2:]
    blurred: Floats = (rows[:, :-2] + rows[:, 1:-1] + rows[:, 2:]) / np.float32(9)
    return blurred


class ChangeScores:
    """Sums over cameras of what M Gaussians have to do with change.

    For a camera let W be a Gaussian's blending weights summed over the pixels, X the same of
    weight times the pixel's growth in squared error since the frame before, R of weight times its
    squared error. A score is (sum sqrt(W X))^2 / sum W + 0.03 (sum sqrt(W R))^2 / sum W: what many
    cameras see changed counts more than what one does.
    """

    def __init__(self, count: int) -> None:
        self._weights, self._changed, self._wrong = (np.zeros(count) for _ in range(3))

    def add(self, rendered: Rendered, now: Floats, before: Floats, counts: Flags) -> Floats:
        """Takes in one camera; gives (M,) the Gaussians' weights.

        now, before: (H, W, 3) the rendered picture minus what the camera sees now, and saw before;
        counts: (H, W) the pixels that count.
        """
        wrong = np.square(_smoothed(now)).sum(axis=2)
        changed = np.maximum(wrong - np.square(_smoothed(before)).sum(axis=2) - LEAST_CHANGE, 0)
        height, width = counts.shape
        planes = np.zeros_like(rendered.picture)
        assert planes.shape[1] % TILE_PX == 0
        for plane, values in zip(planes, (np.ones_like(wrong), changed, wrong), strict=True):
            plane[:height, :width] = np.where(counts, values, 0)
        weights, of_changed, of_wrong = weighed(rendered, planes)
        self._weights += weights
        self._changed += np.sqrt(np.maximum(weights * of_changed, 0))
        self._wrong += np.sqrt(np.maximum(weights * of_wrong, 0))
        return weights

    @property
    def scores(self) -> Doubles:
        """(M,) the scores; 0 for what no camera sees."""
        weights = np.maximum(self._weights, 1e-12)
        scores: Doubles = (self._changed**2 + ERROR_WEIGHT * self._wrong**2) / weights
        return scores


@dataclass(frozen=True, slots=True)
class Comparison:
    """One frame of all cameras, on small copies of their pictures."""

    cameras: tuple[Camera, ...]
    # H and W are those of the largest picture; a smaller one fills the top left corner.
    pictures: Floats  # (C, H, W, 3) float32, in the stream's colours; 1 is white
    errors: Floats  # (C, H, W) float32, 0..1: mean colour difference to what is rendered
    usable: Flags  # (C, H, W) whether all of a pixel's 3 x 3 neighbourhood counts
    # What scene flow needs, where a comparer was asked for it.
    before: Floats | None = None  # (C, H, W, 3) float32, as `pictures`: those of an earlier frame
    weights: Floats | None = None  # (C, M) float32, pixels: what each Gaussian contributes


def _surrounded(counts: Flags) -> Flags:
    """(H - 2, W - 2): whether all of the 3 x 3 flags around each inner one are set."""
    rows = counts[:-2] & counts[1:-1] & counts[2:]
    return rows[:, :-2] & rows[:, 1:-1] & rows[:, 2:]


class Comparer:
    """Compares what is rendered with what the cameras saw, on small pictures."""

    def __init__(
        self,
        views: Sequence[View],
        pictures: Pictures,
        colour: CameraColour,
        for_flow: bool = False,
    ) -> None:
        """views: at any size. for_flow: whether comparisons hold what scene flow needs."""
        self._pictures, self._colour, self._for_flow = pictures, colour, for_flow
        self._views = [View.prepare(small_camera(v.camera), v.near_m) for v in views]
        height = max(v.camera.height_px for v in self._views)
        width = max(v.camera.width_px for v in self._views)
        self._shape = len(self._views), height, width

    def compare(
        self, values: Parameters, rows: Ints, frame: int, before: int | None = None
    ) -> tuple[Comparison, Floats, Doubles]:
        """The Gaussians `rows` against `frame`; (M,) what each of them contributes there, and (M,)
        how much each has to do with what has changed since the frame `before`: zeros if None."""
        pictures, colour, scores = self._pictures, self._colour, ChangeScores(len(rows))
        saw = np.zeros((*self._shape, 3), np.float32)
        errors = np.zeros(self._shape, np.float32)
        usable = np.zeros(self._shape, np.bool_)
        contributions = np.zeros(len(rows), np.float32)
        was_seen = weights = None
        if before is not None and self._for_flow:
            was_seen = np.zeros_like(saw)
            weights = np.zeros((len(self._views), len(rows)), np.float32)
        for i, view in enumerate(self._views):
            width, height = size = view.camera.width_px, view.camera.height_px
            shot = pictures.shot(i, frame)
            small = Image.fromarray(shot.picture).resize(size, Image.Resampling.BOX)
            truth = np.asarray(small, np.float32) / np.float32(255)
            small_mask = None if shot.mask is None else scaled_mask(shot.mask, width, height)
            rendered = render(values, rows, view)
            # A camera's error is measured in its own colours; cameras are matched in the stream's.
            gain, bias = colour.gain(i), colour.bias(i)
            shows = rendered.picture[:, :height, :width].transpose(1, 2, 0) * gain + bias
            errors[i, :height, :width] = np.abs(np.clip(shows, 0, 1) - truth).mean(axis=2)
            saw[i, :height, :width] = (truth - bias) / np.maximum(gain, np.float32(0.1))
            counts = np.ones((height, width), np.bool_) if small_mask is None else small_mask > 0
            usable[i, 1 : height - 1, 1 : width - 1] = _surrounded(counts)
            if before is None:
                contributions += contribution(rendered, small_mask)
            else:
                earlier = Image.fromarray(pictures.shot(i, before).picture)
                was = np.asarray(earlier.resize(size, Image.Resampling.BOX), np.float32)
                was = was / np.float32(255)
                added = scores.add(rendered, shows - truth, shows - was, counts)
                contributions += added
                if was_seen is not None and weights is not None:
                    weights[i] = added
                    was_seen[i, :height, :width] = (was - bias) / np.maximum(gain, np.float32(0.1))
        cameras = tuple(v.camera for v in self._views)
        compared = Comparison(cameras, saw, errors, usable, was_seen, weights)
        return compared, contributions, scores.scores


@kernel(inline="always")
def _difference(pictures, one, x, y, other, other_x, other_y):  # type: ignore[no-untyped-def]
    """Mean colour difference, of 1, of the 3 x 3 pixels around (x, y) of camera `one` to those
    around (other_x, other_y) of camera `other`."""
    total = np.float32(0)
    for dy in range(-1, 2):
        for dx in range(-1, 2):
            for k in range(3):
                total += abs(
                    pictures[other, other_y + dy, other_x + dx, k]
                    - pictures[one, y + dy, x + dx, k]
                )
    return total / np.float32(27)


@kernel(inline="always")
def _cost(  # type: ignore[no-untyped-def]
    pictures, errors, usable, sizes, warps, offsets, neighbours, c, x, y, depth, costs
):
    """How badly `depth` explains what pixel (x, y) of camera c shows; costs is spare memory.

    A camera that is not wrong at the place costs the limit. One that does not see the place, or has
    no usable pixel there, is left out; without two that are left the cost is infinite.
    """
    limit, least_error = np.float32(COST_LIMIT), np.float32(LEAST_ERROR / 2)
    u, v = np.float32(x) + np.float32(0.5), np.float32(y) + np.float32(0.5)
    seeing = 0
    for n in range(neighbours.shape[1]):
        other = neighbours[c, n]
        px, py, w = warped(warps[c, n], offsets[c, n], depth, u, v)
        if w <= 0 or not (0 <= px < sizes[other, 1] and 0 <= py < sizes[other, 0]):
            continue
        ix, iy = np.int32(px), np.int32(py)
        if not usable[other, iy, ix]:
            continue
        costs[seeing] = limit
        if errors[other, iy, ix] >= least_error:
            costs[seeing] = min(_difference(pictures, c, x, y, other, ix, iy), limit)
        seeing += 1
    return better_half(costs, seeing, least=2) if seeing >= 2 else np.float32(np.inf)


@kernel(parallel=True, error_model="numpy")
def _find_depths(  # type: ignore[no-untyped-def]
    pictures, errors, usable, sizes, warps, offsets, neighbours, inverse_depths, which, xs, ys,
    best_depths, best_costs,
):  # fmt: skip
    """For pixel (xs[i], ys[i]) of camera which[i] fills best_depths[i] and its cost, the lowest.

    Both are infinite where at no depth two other cameras see the place. pictures, errors, usable:
    of a Comparison; sizes (C, 2): height and width; warps, offsets, neighbours: of `pair_cameras`.
    """
    coarse = inverse_depths.shape[0]
    nearest, farthest = inverse_depths[0], inverse_depths[coarse - 1]
    step = inverse_depths[1] - inverse_depths[0]
    for i in prange(which.shape[0]):
        costs = np.empty(neighbours.shape[1], np.float32)
        best, best_inverse = np.float32(np.inf), np.float32(0)
        middle = np.float32(0)
        for trial in range(coarse + 2 * FINER + 1):
            if trial < coarse:
                inverse = inverse_depths[trial]
            else:
                if trial == coarse:
                    middle = best_inverse
                inverse = middle + step * np.float32(trial - coarse - FINER) / np.float32(FINER)
                inverse = min(max(inverse, farthest), nearest)
            cost = _cost(
                pictures, errors, usable, sizes, warps, offsets, neighbours, which[i], xs[i], ys[i],
                np.float32(1) / inverse, costs,
            )  # fmt: skip
            if cost < best:
                best, best_inverse = cost, inverse
        best_costs[i] = best
        best_depths[i] = np.float32(1) / best_inverse


def _draw_wrong_pixels(compared: Comparison, most: int, rng: np.random.Generator) -> Longs:
    """(D, 3) camera, row and column of at most `most` wrong pixels, in random order.

    The more a pixel is wrong, the likelier it is drawn.
    """
    wrong = compared.usable & (compared.errors >= LEAST_ERROR)
    weights = np.where(wrong, compared.errors, 0).reshape(-1)
    places = np.flatnonzero(weights)
    draws = min(most, len(places))
    if draws == 0:
        return np.zeros((0, 3), np.int64)
    chances = weights[places].astype(np.float64)
    drawn = rng.choice(places, draws, replace=False, p=chances / chances.sum())
    return np.stack(np.unravel_index(drawn, compared.errors.shape), axis=1)


def missing_splats(
    compared: Comparison,
    count: int,
    near_m: float,
    far_m: float,
    sh_degree: int,
    rng: np.random.Generator,
) -> Splats:
    """At most `count` Gaussians, in random order, where the cameras see what is not rendered."""
    cameras = compared.cameras
    # Twice as many as wanted, as not all are found in other cameras.
    drawn = _draw_wrong_pixels(compared, 2 * count, rng)
    if len(drawn) == 0:
        return Splats.empty(sh_degree)
    which, ys, xs = map(np.ascontiguousarray, drawn.T)
    sizes = np.array([(c.height_px, c.width_px) for c in cameras], np.int32)
    neighbours, warps, offsets = pair_cameras(cameras)
    depths = np.empty(len(drawn), np.float32)
    costs = np.empty(len(drawn), np.float32)
    _find_depths(
        compared.pictures, compared.errors, compared.usable, sizes, warps, offsets, neighbours,
        tried_inverse_depths(near_m, far_m), which, xs, ys, depths, costs,
    )  # fmt: skip
    kept = np.flatnonzero(costs <= COST_ACCEPTED)[:count]
    which, xs, ys, depths = which[kept], xs[kept], ys[kept], depths[kept]
    positions = np.zeros((len(kept), 3), np.float32)
    pixel_m = np.zeros(len(kept), np.float32)
    for i, camera in enumerate(cameras):
        own = which == i
        positions[own] = camera.unproject(xs[own] + 0.5, ys[own] + 0.5, depths[own])
        pixel_m[own] = depths[own] / np.float32(camera.fx_px)
    colours = np.clip(compared.pictures[which, ys, xs] * 255, 0, 255).astype(np.uint8)
    splats = initial_splats(positions, colours, sh_degree)
    # The size follows from the neighbours, within bounds: cameras may find a place twice.
    smallest, largest = (np.log(px * pixel_m)[:, None] for px in (SMALLEST_PX, LARGEST_PX))
    np.clip(splats.log_scales, smallest, largest, out=splats.log_scales)
    return splats
