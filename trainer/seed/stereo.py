"""Plane-sweep stereo: how far away every pixel of every camera is, from one frame of all cameras.

For a grid of depths the neighbouring cameras are warped to the reference; the depth whose windows
agree best wins, and is kept where the neighbours' own depth maps agree with it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from PIL import Image

from codec.arrays import Bytes, Flags, Floats, Ints
from codec.camera import Camera
from codec.kernel import kernel, prange

MAX_SIDE_PX = 256
"""Longer side of the pictures that are compared."""

DEPTHS = 64
"""Depths tried, evenly spaced in inverse depth."""

NEIGHBOURS = 6
"""Cameras that a depth is checked in: those whose direction is nearest."""

RADIUS_PX = 4
"""Half a window's side, rounded down. Large, as walls without texture need some feature inside."""

COLOUR_WEIGHT = 0.25
"""Weight of a pixel's colour beside its difference to its surroundings; small, since the cameras of
a rig differ in colour."""

COST_LIMIT = 40.0
"""Largest cost of a pixel, of 255: what is hidden in one camera must not outvote the rest."""

TOLERANCE = 0.05
"""Relative difference at which two cameras' depths agree."""


@dataclass(frozen=True, slots=True)
class DepthMaps:
    """Depth maps of one frame, for small copies of the cameras' pictures."""

    cameras: tuple[Camera, ...]  # of the small pictures
    depths: Floats  # (C, H, W) float32, metres along the viewing axis; 0 where unknown
    agreeing: Ints  # (C, H, W) int32: neighbours whose depth maps agree


def _box(plane: Floats, radius: int) -> Floats:
    """Mean over a square window of the last two axes, edges repeated."""
    for axis in (-2, -1):
        pad = [(0, 0)] * plane.ndim
        pad[axis] = (radius + 1, radius)
        total = np.cumsum(np.pad(plane, pad, mode="edge"), axis=axis, dtype=np.float64)
        size = 2 * radius + 1
        ends = np.take(total, range(size, total.shape[axis]), axis=axis)
        begins = np.take(total, range(total.shape[axis] - size), axis=axis)
        plane = ((ends - begins) / size).astype(np.float32)
    return plane


def _features(picture: Bytes) -> Floats:
    """(6, H, W): every channel's difference to its surroundings, and its weighted colour."""
    planes = np.ascontiguousarray(picture.transpose(2, 0, 1), np.float32)
    return np.concatenate([planes - _box(planes, 2 * RADIUS_PX), COLOUR_WEIGHT * planes])


@kernel(fastmath=True)
def _window_sums(plane, radius, row_sums, out):  # type: ignore[no-untyped-def]
    """Sums over a square window, cut off at the edges; row_sums is spare memory."""
    height, width = plane.shape
    for y in range(height):
        total = np.float32(0)
        for x in range(min(radius, width)):
            total += plane[y, x]
        for x in range(width):
            if x + radius < width:
                total += plane[y, x + radius]
            if x - radius - 1 >= 0:
                total -= plane[y, x - radius - 1]
            row_sums[y, x] = total
    for x in range(width):
        out[0, x] = np.float32(0)
    for y in range(min(radius + 1, height)):
        for x in range(width):
            out[0, x] += row_sums[y, x]
    for y in range(1, height):
        for x in range(width):
            total = out[y - 1, x]
            if y + radius < height:
                total += row_sums[y + radius, x]
            if y - radius - 1 >= 0:
                total -= row_sums[y - radius - 1, x]
            out[y, x] = total


@kernel(inline="always")
def better_half(costs, count, least):  # type: ignore[no-untyped-def]
    """Mean of the lower half of costs[:count], but of no fewer than `least` costs; sorts them.

    Each is the cost of one camera, and something may hide the place from the worse half. Of two
    cameras the better half is one. Here that is enough (least = 1), because `_count_agreeing`
    checks the depth afterwards. Nothing checks what `trainer.fit.renew` finds, so there two cameras
    have to agree (least = 2).
    """
    for i in range(1, count):
        cost = costs[i]
        at = i
        while at > 0 and costs[at - 1] > cost:
            costs[at] = costs[at - 1]
            at -= 1
        costs[at] = cost
    keep = max(least, (count + 1) // 2)
    total = np.float32(0)
    for i in range(keep):
        total += costs[i]
    return total / np.float32(keep)


@kernel(fastmath=True, parallel=True, error_model="numpy")
def _sweep(  # type: ignore[no-untyped-def]
    features, sizes, warps, offsets, neighbours, inverse_depths, radius, limit, best_depths
):
    """Fills best_depths (C, H, W), 0 where fewer than two neighbours see a pixel at any depth.

    features (C, 6, H, W), of which camera c fills sizes[c] = (height, width); neighbours, warps,
    offsets: of `pair_cameras`.
    """
    zero, half = np.float32(0), np.float32(0.5)
    count = neighbours.shape[1]
    for c in prange(features.shape[0]):
        height, width = sizes[c, 0], sizes[c, 1]
        cost = np.empty((height, width), np.float32)
        seen = np.empty((height, width), np.float32)
        spare = np.empty((height, width), np.float32)
        cost_sums = np.empty((height, width), np.float32)
        costs = np.empty((count, height, width), np.float32)
        seen_sums = np.empty((height, width), np.float32)
        best_costs = np.full((height, width), np.inf, np.float32)
        of_seeing = np.empty(count, np.float32)
        for d in range(inverse_depths.shape[0]):
            depth = np.float32(1) / inverse_depths[d]
            for n in range(count):
                other = neighbours[c, n]
                m, o = warps[c, n], offsets[c, n]
                end_y, end_x = np.float32(sizes[other, 0]), np.float32(sizes[other, 1])
                for y in range(height):
                    # `warped`, but what a row shares is worked out once: a tenth faster.
                    v = np.float32(y) + half
                    bx = depth * (m[0, 1] * v + m[0, 2]) + o[0]
                    by = depth * (m[1, 1] * v + m[1, 2]) + o[1]
                    bw = depth * (m[2, 1] * v + m[2, 2]) + o[2]
                    for x in range(width):
                        u = depth * (np.float32(x) + half)
                        w = m[2, 0] * u + bw
                        cost[y, x] = zero
                        seen[y, x] = zero
                        if w <= zero:
                            continue
                        px, py = (m[0, 0] * u + bx) / w, (m[1, 0] * u + by) / w
                        if not (zero <= px < end_x and zero <= py < end_y):
                            continue
                        ix, iy = np.int32(px), np.int32(py)
                        total = zero
                        for k in range(6):
                            total += abs(features[other, k, iy, ix] - features[c, k, y, x])
                        cost[y, x] = min(total, limit)
                        seen[y, x] = np.float32(1)
                _window_sums(cost, radius, spare, cost_sums)
                _window_sums(seen, radius, spare, seen_sums)
                for y in range(height):
                    for x in range(width):
                        there = seen[y, x] > zero and seen_sums[y, x] > half
                        costs[n, y, x] = (
                            cost_sums[y, x] / seen_sums[y, x] if there else np.float32(1e9)
                        )
            for y in range(height):
                for x in range(width):
                    seeing = 0
                    for n in range(count):
                        if costs[n, y, x] < np.float32(1e8):
                            of_seeing[seeing] = costs[n, y, x]
                            seeing += 1
                    if seeing < 2:
                        continue
                    mean = better_half(of_seeing, seeing, least=1)
                    if mean < best_costs[y, x]:
                        best_costs[y, x] = mean
                        best_depths[c, y, x] = depth


@kernel(error_model="numpy")
def warped(warp, offset, depth, u, v):  # type: ignore[no-untyped-def]
    """Where a neighbour of `pair_cameras` sees pixel (u, v) at `depth`: x and y in pixels, and how
    deep, metres; not at all where that is not above 0."""
    w = depth * (warp[2, 0] * u + warp[2, 1] * v + warp[2, 2]) + offset[2]
    x = (depth * (warp[0, 0] * u + warp[0, 1] * v + warp[0, 2]) + offset[0]) / w
    y = (depth * (warp[1, 0] * u + warp[1, 1] * v + warp[1, 2]) + offset[1]) / w
    return x, y, w


@kernel(parallel=True, error_model="numpy")
def _count_agreeing(depths, sizes, warps, offsets, neighbours, tolerance, agreeing):  # type: ignore[no-untyped-def]
    for c in prange(depths.shape[0]):
        for y in range(sizes[c, 0]):
            for x in range(sizes[c, 1]):
                depth = depths[c, y, x]
                if depth <= 0:
                    continue
                u, v = np.float32(x) + np.float32(0.5), np.float32(y) + np.float32(0.5)
                for n in range(neighbours.shape[1]):
                    other = neighbours[c, n]
                    m, o = warps[c, n], offsets[c, n]
                    px, py, w = warped(m, o, depth, u, v)
                    if w <= 0:
                        continue
                    if not (0 <= px < sizes[other, 1] and 0 <= py < sizes[other, 0]):
                        continue
                    if abs(depths[other, int(py), int(px)] - w) < tolerance * w:
                        agreeing[c, y, x] += 1


def small_camera(camera: Camera) -> Camera:
    """The camera at the size that depths are found at."""
    shrink = min(1.0, MAX_SIDE_PX / max(camera.width_px, camera.height_px))
    return camera.scaled(shrink)


def pair_cameras(cameras: Sequence[Camera]) -> tuple[Ints, Floats, Floats]:
    """(C, N) int32 each camera's neighbours, those that look in the most similar direction first;
    (C, N, 3, 3) and (C, N, 3) float32: at depth d, pixel (u, v) of camera c lies in its n-th
    neighbour at d * warps[c, n] (u, v, 1) + offsets[c, n], homogeneous."""
    intrinsics = np.stack([c.intrinsics for c in cameras])
    to_pixel = intrinsics @ np.stack([c.w2c[:3, :3] for c in cameras])
    to_ray = np.linalg.inv(to_pixel)
    positions = np.stack([c.position for c in cameras])
    forwards = np.stack([c.forward for c in cameras])
    likeness = forwards @ forwards.T
    np.fill_diagonal(likeness, -np.inf)
    neighbours = np.argsort(-likeness, axis=1)[:, : min(NEIGHBOURS, len(cameras) - 1)]
    warps = (to_pixel[neighbours] @ to_ray[:, None]).astype(np.float32)
    offsets = np.einsum(
        "cnij,cnj->cni", to_pixel[neighbours], positions[:, None] - positions[neighbours]
    ).astype(np.float32)
    return neighbours.astype(np.int32), warps, offsets


def tried_inverse_depths(near_m: float, far_m: float) -> Floats:
    """(DEPTHS,) float32: inverse depths, 1/m, the nearest first."""
    return np.linspace(1 / near_m, 1 / far_m, DEPTHS).astype(np.float32)


def depth_maps(
    cameras: Sequence[Camera],
    pictures: Sequence[Bytes],
    near_m: float,
    far_m: float,
) -> DepthMaps:
    """Depths between near_m and far_m for two or more cameras of any sizes.

    pictures: one per camera, (H, W, 3) uint8 of its size.
    """
    small = tuple(small_camera(c) for c in cameras)
    sizes = np.array([(c.height_px, c.width_px) for c in small], np.int32)
    height, width = sizes.max(axis=0)
    features = np.zeros((len(small), 6, height, width), np.float32)
    for i, (camera, picture) in enumerate(zip(small, pictures, strict=True)):
        size = (camera.width_px, camera.height_px)
        resized = np.asarray(Image.fromarray(picture).resize(size, Image.Resampling.BOX))
        features[i, :, : camera.height_px, : camera.width_px] = _features(resized)
    neighbours, warps, offsets = pair_cameras(small)
    depths = np.zeros((len(small), height, width), np.float32)
    _sweep(
        features, sizes, warps, offsets, neighbours, tried_inverse_depths(near_m, far_m), RADIUS_PX,
        np.float32(COST_LIMIT), depths,
    )  # fmt: skip
    agreeing = np.zeros(depths.shape, np.int32)
    _count_agreeing(depths, sizes, warps, offsets, neighbours, np.float32(TOLERANCE), agreeing)
    return DepthMaps(small, depths, agreeing)


def _nearest_depths(points: Floats, camera: Camera) -> Floats:
    """(h, w) depth of the nearest of `points` (N, 3) behind every pixel; inf where none is."""
    u_px, v_px, depths = camera.project(points)
    x, y = np.floor(u_px), np.floor(v_px)
    inside = (depths > 0) & (x >= 0) & (x < camera.width_px) & (y >= 0) & (y < camera.height_px)
    nearest = np.full((camera.height_px, camera.width_px), np.inf, np.float32)
    places = y[inside].astype(np.int64), x[inside].astype(np.int64)
    np.minimum.at(nearest, places, depths[inside])
    return nearest


def _filled(inverse: Floats, known: Flags) -> Floats:
    """`inverse` with its unknown pixels drawn smoothly from the known ones, coarse to fine."""
    height, width = inverse.shape
    if known.all() or min(height, width) == 1:
        mean = inverse[known].mean() if known.any() else 0.0
        return np.where(known, inverse, np.float32(mean)).astype(np.float32)
    even = [(0, height % 2), (0, width % 2)]
    weight = np.pad(known.astype(np.float32), even).reshape(
        (height + 1) // 2, 2, (width + 1) // 2, 2
    )
    value = np.pad(np.where(known, inverse, 0), even).reshape(weight.shape)
    count = weight.sum(axis=(1, 3))
    coarse = value.sum(axis=(1, 3)) / np.maximum(count, 1)
    below = _filled(coarse.astype(np.float32), count > 0)
    above = np.asarray(
        Image.fromarray(below).resize((width, height), Image.Resampling.BILINEAR), np.float32
    )
    return np.where(known, inverse, above).astype(np.float32)


def agreed_places(maps: DepthMaps, least: int) -> Floats:
    """(P, 3) float32, metres, world: what pixels see on whose depth `least` neighbours agree."""
    places = []
    for camera, depths, agreeing in zip(maps.cameras, maps.depths, maps.agreeing, strict=True):
        v, u = np.nonzero(agreeing[: camera.height_px, : camera.width_px] >= least)
        middles = u.astype(np.float32) + 0.5, v.astype(np.float32) + 0.5
        places.append(camera.unproject(*middles, depths[v, u]).astype(np.float32))
    return np.concatenate(places)


def completed(maps: DepthMaps) -> list[Floats]:
    """For every camera (h, w) float32 depths without holes, metres.

    Kept is what two neighbours agree on, and what three agree on in any other camera, seen from
    this one; the rest is filled smoothly in inverse depth, in which planes are linear.
    """
    everywhere = agreed_places(maps, 3)
    result = []
    for camera, depths, agreeing in zip(maps.cameras, maps.depths, maps.agreeing, strict=True):
        shape = camera.height_px, camera.width_px
        nearest = _nearest_depths(everywhere, camera)
        own = agreeing[: shape[0], : shape[1]] >= 2
        nearest[own] = depths[: shape[0], : shape[1]][own]
        known = np.isfinite(nearest)
        inverse = np.where(known, 1 / nearest, 0).astype(np.float32)
        result.append((1 / np.maximum(_filled(inverse, known), 1e-6)).astype(np.float32))
    return result
