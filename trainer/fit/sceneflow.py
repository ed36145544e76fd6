"""Scene flow: where each Gaussian went from one frame to the next, by what the cameras saw.

A step of training moves a Gaussian by about a millimetre, and its gradient reaches no further than
its own pixels: a hand or a ball that moves by more is lost. Here each Gaussian that the cameras saw
change is looked for in the new pictures, together with its neighbours: PatchMatch over motions in
space, in which neighbours hand on what fits. Each camera is compared with itself a frame before, so
its colours do not matter. Whatever did not change, or is not found, stays.
"""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree

from codec.arrays import Doubles, Floats, Ints
from codec.camera import Camera
from codec.kernel import kernel, prange
from trainer.seed.stereo import better_half

from .renew import Comparison

CAMERAS = 6
"""Cameras that a Gaussian is followed in: those that see most of it."""

LEAST_WEIGHT = 0.05
"""Pixels of a small picture that a Gaussian must contribute to for a camera to follow it."""

NEIGHBOURS = 8
"""Gaussians that move nearly alike, with the one in their middle."""

LEAST_CHANGED = 3
"""Gaussians that must have changed for any to be looked for: fewer cannot agree."""

CHANGED = 0.02
"""Mean colour difference, of 1, from which on a Gaussian's surroundings have changed."""

BETTER = 0.6
"""Share of the cost without a motion that the cost with it must be below."""

COST_LIMIT = 0.25
"""Largest cost of a camera, of 1: one that something hides the place from must not outvote the
rest."""

COST_PER_PX = 2e-4
"""Cost of a motion, for each pixel of its length: where all motions fit, the shortest wins."""

RADII_PX = (16.0, 16.0, 8.0, 4.0, 2.0, 1.0, 0.5, 0.25)
"""How far from the best motion so far each round tries others, in pixels of the small pictures."""

TRIES = 6
"""Motions that a round tries at random for each Gaussian."""

SPACING_PX = 1.5
"""Distance of the four places around a Gaussian's middle that are compared as well."""

PLACES = 5


@kernel(inline="always")
def _sampled(pictures, c, u, v):  # type: ignore[no-untyped-def]
    """The colour of camera c's picture at (u, v) px, inside all pixel centres."""
    x, y = u - np.float32(0.5), v - np.float32(0.5)
    ix, iy = np.int32(x), np.int32(y)
    fx, fy = x - np.float32(ix), y - np.float32(iy)
    gx, gy = np.float32(1) - fx, np.float32(1) - fy
    a, b = pictures[c, iy, ix], pictures[c, iy, ix + 1]
    d, e = pictures[c, iy + 1, ix], pictures[c, iy + 1, ix + 1]
    red = gy * (gx * a[0] + fx * b[0]) + fy * (gx * d[0] + fx * e[0])
    green = gy * (gx * a[1] + fx * b[1]) + fy * (gx * d[1] + fx * e[1])
    blue = gy * (gx * a[2] + fx * b[2]) + fy * (gx * d[2] + fx * e[2])
    return red, green, blue


@kernel(inline="always")
def _place(projections, sizes, usable, c, x, y, z):  # type: ignore[no-untyped-def]
    """(u, v) px of a point in camera c, and whether all of its surroundings are seen."""
    p = projections[c]
    w = p[2, 0] * x + p[2, 1] * y + p[2, 2] * z + p[2, 3]
    if w <= np.float32(1e-6):
        return np.float32(0), np.float32(0), False
    u = (p[0, 0] * x + p[0, 1] * y + p[0, 2] * z + p[0, 3]) / w
    v = (p[1, 0] * x + p[1, 1] * y + p[1, 2] * z + p[1, 3]) / w
    edge = np.float32(SPACING_PX + 1)
    inside = u >= edge and v >= edge
    inside = inside and u < sizes[c, 1] - edge and v < sizes[c, 0] - edge
    if not inside:
        return u, v, False
    return u, v, usable[c, np.int32(v), np.int32(u)]


@kernel(inline="always")
def _offset(place):  # type: ignore[no-untyped-def]
    """(du, dv) px of a place from the middle."""
    if place == 0:
        return np.float32(0), np.float32(0)
    step = np.float32(SPACING_PX) if place % 2 else -np.float32(SPACING_PX)
    return (step, np.float32(0)) if place < 3 else (np.float32(0), step)


@kernel()
def _fill_templates(  # type: ignore[no-untyped-def]
    before, projections, sizes, usable, means, cameras, templates
):
    """templates (M, K, PLACES, 3): what the cameras (M, K) saw around (M, 3) means; a camera that
    did not see all of it becomes -1."""
    for i in range(means.shape[0]):
        for k in range(cameras.shape[1]):
            c = cameras[i, k]
            if c < 0:
                continue
            u, v, inside = _place(
                projections, sizes, usable, c, means[i, 0], means[i, 1], means[i, 2]
            )
            if not inside:
                cameras[i, k] = -1
                continue
            for place in range(PLACES):
                du, dv = _offset(place)
                red, green, blue = _sampled(before, c, u + du, v + dv)
                templates[i, k, place, 0] = red
                templates[i, k, place, 1] = green
                templates[i, k, place, 2] = blue


@kernel()
def _own_cost(  # type: ignore[no-untyped-def]
    now, projections, sizes, usable, means, cameras, templates, i, motion, costs
):
    """How unlike its template a Gaussian's new place looks, 0..1, in the better half of its
    cameras; the limit where no two see it. costs is spare memory."""
    limit = np.float32(COST_LIMIT)
    seeing = 0
    for k in range(cameras.shape[1]):
        c = cameras[i, k]
        if c < 0:
            continue
        u, v, inside = _place(
            projections, sizes, usable, c,
            means[i, 0] + motion[0], means[i, 1] + motion[1], means[i, 2] + motion[2],
        )  # fmt: skip
        if not inside:
            continue
        total = np.float32(0)
        for place in range(PLACES):
            du, dv = _offset(place)
            red, green, blue = _sampled(now, c, u + du, v + dv)
            total += abs(red - templates[i, k, place, 0])
            total += abs(green - templates[i, k, place, 1])
            total += abs(blue - templates[i, k, place, 2])
        costs[seeing] = min(total / np.float32(3 * PLACES), limit)
        seeing += 1
    return better_half(costs, seeing, 2) if seeing >= 2 else limit


@kernel()
def _shared_cost(  # type: ignore[no-untyped-def]
    now, projections, sizes, usable, means, cameras, templates, near, i, motion, pixel_m, bound,
    costs,
):  # fmt: skip
    """The mean cost of Gaussian i and its neighbours if all of them move alike; infinite where it
    is at least `bound`."""
    count = np.float32(near.shape[1])
    length = np.sqrt(motion[0] ** 2 + motion[1] ** 2 + motion[2] ** 2)
    total = count * np.float32(COST_PER_PX) * length / pixel_m[i]
    for n in range(near.shape[1]):
        total += _own_cost(
            now, projections, sizes, usable, means, cameras, templates, near[i, n], motion, costs
        )
        if total >= bound * count:
            return np.float32(np.inf)
    return total / count


@kernel(parallel=True)
def _search(  # type: ignore[no-untyped-def]
    now, projections, sizes, usable, means, cameras, templates, near, pixel_m, radius_px, tries,
    motions, best, new_motions, new_best,
):  # fmt: skip
    """One round: each Gaussian tries the motions (M, 3) of its neighbours, and those at the offsets
    tries (M, T, 3), of the unit ball, from the best of them."""
    for i in prange(means.shape[0]):
        costs = np.empty(cameras.shape[1], np.float32)
        chosen, trial = np.empty(3, np.float32), np.empty(3, np.float32)
        for axis in range(3):
            chosen[axis] = motions[i, axis]
        least = best[i]
        for attempt in range(near.shape[1] + tries.shape[1]):
            is_same = True
            for axis in range(3):
                if attempt < near.shape[1]:
                    trial[axis] = motions[near[i, attempt], axis]
                else:
                    offset = tries[i, attempt - near.shape[1], axis]
                    trial[axis] = chosen[axis] + offset * np.float32(radius_px) * pixel_m[i]
                is_same = is_same and trial[axis] == chosen[axis]
            if is_same:
                continue
            cost = _shared_cost(
                now, projections, sizes, usable, means, cameras, templates, near, i, trial,
                pixel_m, least, costs,
            )  # fmt: skip
            if cost < least:
                least = cost
                for axis in range(3):
                    chosen[axis] = trial[axis]
        for axis in range(3):
            new_motions[i, axis] = chosen[axis]
        new_best[i] = least


@kernel()
def _costs_of(  # type: ignore[no-untyped-def]
    now, projections, sizes, usable, means, cameras, templates, near, pixel_m, motions, out
):
    """out (M,): the shared cost of each Gaussian's motion."""
    costs = np.empty(cameras.shape[1], np.float32)
    for i in range(means.shape[0]):
        out[i] = _shared_cost(
            now, projections, sizes, usable, means, cameras, templates, near, i, motions[i],
            pixel_m, np.float32(np.inf), costs,
        )  # fmt: skip


def _following(weights: Floats) -> Ints:
    """(M, CAMERAS) int32: the cameras that see most of each Gaussian; -1 where they see too
    little. weights: (C, M)."""
    count = min(CAMERAS, len(weights))
    cameras = np.argsort(-weights, axis=0, kind="stable")[:count].T
    seen = np.take_along_axis(weights.T, cameras, axis=1)
    following: Ints = np.where(seen >= LEAST_WEIGHT, cameras, -1).astype(np.int32)
    return np.ascontiguousarray(following)


def scene_flow(
    compared: Comparison, means: Floats, guesses: Floats, rng: np.random.Generator
) -> Floats:
    """(M, 3) float32, metres: the motion of each of the Gaussians at (M, 3) `means` since the
    comparison's earlier frame; 0 where the cameras saw no change, or do not agree on one.

    guesses: (M, 3) motions that are tried first, such as the last ones.
    """
    if compared.before is None or compared.weights is None:
        raise ValueError("a comparison with an earlier frame is needed")
    motions = np.zeros_like(means)
    projections = np.stack([_projection(c) for c in compared.cameras]).astype(np.float32)
    sizes = np.array([(c.height_px, c.width_px) for c in compared.cameras], np.int32)
    cameras = _following(compared.weights)
    templates = np.zeros((*cameras.shape, PLACES, 3), np.float32)
    seen = projections, sizes, compared.usable
    _fill_templates(compared.before, *seen, means, cameras, templates)
    still, alone = np.empty(len(means), np.float32), np.arange(len(means), dtype=np.int32)
    _costs_of(
        compared.pictures, *seen, means, cameras, templates, alone[:, None], np.ones_like(still),
        motions, still,
    )  # fmt: skip
    changed = np.flatnonzero((still >= CHANGED) & ((cameras >= 0).sum(axis=1) >= 2))
    if len(changed) < LEAST_CHANGED:
        return motions
    means, cameras, templates = means[changed], cameras[changed], templates[changed]
    near = cKDTree(means).query(means, min(NEIGHBOURS, len(means)))[1].astype(np.int32)
    pixel_m = _pixel_sizes_m(compared, means, cameras)
    scene = (compared.pictures, *seen, means, cameras, templates, near)
    found, least = np.zeros_like(means), np.empty(len(means), np.float32)
    _costs_of(*scene, pixel_m, found, least)
    unmoved = least.copy()
    guessed, of_guess = guesses[changed], np.empty(len(means), np.float32)
    _costs_of(*scene, pixel_m, guessed, of_guess)
    better = of_guess < least
    found[better], least[better] = guessed[better], of_guess[better]
    for radius_px in RADII_PX:
        tries = _in_unit_ball((len(means), TRIES), rng)
        new_found, new_least = np.empty_like(found), np.empty_like(least)
        _search(*scene, pixel_m, radius_px, tries, found, least, new_found, new_least)
        found, least = new_found, new_least
    found[least >= BETTER * unmoved] = 0
    # What only one of many neighbours does is a mistake.
    agreed = np.median(found[near], axis=1).astype(np.float32)
    _costs_of(*scene, pixel_m, agreed, least)
    agreed[least >= BETTER * unmoved] = 0
    motions[changed] = agreed
    return motions


def _projection(camera: Camera) -> Doubles:
    """(3, 4) from world to homogeneous pixels."""
    k = np.array(
        [
            [camera.fx_px, 0, camera.cx_px],
            [0, camera.fy_px, camera.cy_px],
            [0, 0, 1],
        ]
    )
    return k @ camera.w2c[:3]


def _pixel_sizes_m(compared: Comparison, means: Floats, cameras: Ints) -> Floats:
    """(M,) metres that a pixel is wide at each of `means`, in the camera that sees most of it."""
    places = np.stack([c.position for c in compared.cameras])
    focal_px = np.array([c.fx_px for c in compared.cameras])
    first = np.take_along_axis(cameras, np.argmax(cameras >= 0, axis=1)[:, None], axis=1)[:, 0]
    apart_m = np.linalg.norm(means - places[first], axis=1)
    sizes: Floats = (apart_m / focal_px[first]).astype(np.float32)
    return sizes


def _in_unit_ball(shape: tuple[int, int], rng: np.random.Generator) -> Floats:
    """(*shape, 3) float32, dense in the middle."""
    away = rng.normal(size=(*shape, 3))
    away *= rng.random((*shape, 1)) / np.linalg.norm(away, axis=-1, keepdims=True)
    return away.astype(np.float32)
