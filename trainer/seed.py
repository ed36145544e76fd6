"""The first Gaussians: a capture's own points, and seeds where the cameras agree on a colour."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt
from numba import njit, prange

from codec.camera import Camera
from codec.splats import SH_C0, Splats, sh_count

Floats = npt.NDArray[np.float32]

RAY_DEPTHS = 64
"""Depths tried along a ray, evenly spaced in inverse depth."""

NEIGHBOURS = 6
"""Cameras that a depth is checked in: those whose direction is nearest."""

INITIAL_OPACITY = 0.5
"""3DGS-MCMC's start: opaque enough to get gradients, not so much that it hides others."""

SPACING_SCALE = 0.5
"""Initial standard deviation over the distance to the nearest neighbours."""


@njit(cache=True, parallel=True)
def _sweep_rays(  # type: ignore[no-untyped-def]
    pictures, world_to_pixel, rays_camera, origins, directions, colours, neighbours, inverse_depths,
    best_depths,
):  # fmt: skip
    """For every ray the depth (along the viewing axis) whose colours in other cameras fit best."""
    height, width = pictures.shape[1], pictures.shape[2]
    for i in prange(len(origins)):
        best = np.float32(np.inf)
        best_depth = np.float32(0)
        costs = np.empty(neighbours.shape[1], np.float32)
        for d in range(len(inverse_depths)):
            depth = 1 / inverse_depths[d]
            x = origins[i, 0] + depth * directions[i, 0]
            y = origins[i, 1] + depth * directions[i, 1]
            z = origins[i, 2] + depth * directions[i, 2]
            seen = 0
            for n in range(neighbours.shape[1]):
                c = neighbours[rays_camera[i], n]
                m = world_to_pixel[c]
                w = m[2, 0] * x + m[2, 1] * y + m[2, 2] * z + m[2, 3]
                if w <= 0:
                    continue
                u = (m[0, 0] * x + m[0, 1] * y + m[0, 2] * z + m[0, 3]) / w
                v = (m[1, 0] * x + m[1, 1] * y + m[1, 2] * z + m[1, 3]) / w
                if not (0 <= u < width and 0 <= v < height):
                    continue
                cost = np.float32(0)
                for k in range(3):
                    cost += abs(pictures[c, int(v), int(u), k] - colours[i, k])
                costs[seen] = cost
                seen += 1
            if seen < 2:
                continue
            # The better half: something may hide the point from the others.
            ordered = np.sort(costs[:seen])
            keep = (seen + 1) // 2
            cost = np.float32(0)
            for k in range(keep):
                cost += ordered[k] / keep
            if cost < best:
                best = cost
                best_depth = np.float32(depth)
        best_depths[i] = best_depth


def sweep_seeds(
    cameras: Sequence[Camera],
    pictures: npt.NDArray[np.uint8],
    count: int,
    near_m: float,
    far_m: float,
    rng: np.random.Generator,
) -> tuple[Floats, npt.NDArray[np.uint8]]:
    """Up to `count` points on random rays, each where other cameras see the ray's own colour best.

    cameras share one size; pictures (C, H, W, 3) uint8. Gives positions (P, 3) float32, metres,
    world, and colours (P, 3) uint8; rays that fewer than two other cameras see anywhere give none.
    """
    height, width = pictures.shape[1:3]
    # Blurred by 3x3: a depth step must not miss a thin match.
    padded = np.pad(pictures.astype(np.float32), ((0, 0), (1, 1), (1, 1), (0, 0)), mode="edge")
    blurred = np.zeros(pictures.shape, np.float32)
    for dy in range(3):
        for dx in range(3):
            blurred += padded[:, dy : dy + height, dx : dx + width]
    blurred /= 9
    world_to_pixel = np.stack(
        [
            np.array([[c.fx_px, 0, c.cx_px], [0, c.fy_px, c.cy_px], [0, 0, 1]]) @ c.w2c[:3]
            for c in cameras
        ]
    )
    forwards = np.stack([c.forward for c in cameras])
    likeness = forwards @ forwards.T
    np.fill_diagonal(likeness, -np.inf)
    neighbours = np.argsort(-likeness, axis=1)[:, : min(NEIGHBOURS, len(cameras) - 1)]

    which = rng.integers(len(cameras), size=count)
    u, v = rng.integers(width, size=count), rng.integers(height, size=count)
    in_camera = np.stack(
        [
            (u + 0.5 - np.array([c.cx_px for c in cameras])[which])
            / np.array([c.fx_px for c in cameras])[which],
            (v + 0.5 - np.array([c.cy_px for c in cameras])[which])
            / np.array([c.fy_px for c in cameras])[which],
            np.ones(count),
        ],
        axis=1,
    )
    rotations = np.stack([c.w2c[:3, :3] for c in cameras])[which]
    directions = np.einsum("nij,ni->nj", rotations, in_camera)
    origins = np.stack([c.position for c in cameras])[which]
    depths = np.zeros(count, np.float32)
    _sweep_rays(
        blurred, world_to_pixel, which, origins, directions, blurred[which, v, u],
        neighbours, np.linspace(1 / near_m, 1 / far_m, RAY_DEPTHS), depths,
    )  # fmt: skip
    found = depths > 0
    points = origins[found] + depths[found, None] * directions[found]
    return points.astype(np.float32), pictures[which, v, u][found]


@njit(cache=True, parallel=True)
def _spacings(points, out):  # type: ignore[no-untyped-def]
    """Root mean square distance of every point to its three nearest others."""
    for i in prange(len(points)):
        a = b = c = np.float32(np.inf)
        for j in range(len(points)):
            if i == j:
                continue
            dx = points[i, 0] - points[j, 0]
            dy = points[i, 1] - points[j, 1]
            dz = points[i, 2] - points[j, 2]
            d = dx * dx + dy * dy + dz * dz
            if d < c:
                if d < a:
                    a, b, c = d, a, b
                elif d < b:
                    b, c = d, b
                else:
                    c = d
        out[i] = np.sqrt((a + b + c) / np.float32(3))


def initial_splats(points: Floats, colours: npt.NDArray[np.uint8], sh_degree: int) -> Splats:
    """Round Gaussians at `points` (N, 3), sized by their neighbours, coloured by `colours` (N,
    3)."""
    count = len(points)
    spacing = np.full(count, 0.1, np.float32)
    if count > 3:
        _spacings(points, spacing)
    # Points that coincide, and points far from all others, must not start as specks or as fog.
    middle = float(np.median(spacing))
    spacing = np.clip(spacing, 0.1 * middle + 1e-6, 10 * middle + 1e-6)
    quats = np.zeros((count, 4), np.float32)
    quats[:, 0] = 1
    sh = np.zeros((count, sh_count(sh_degree), 3), np.float32)
    sh[:, 0] = (colours.astype(np.float32) / 255 - 0.5) / np.float32(SH_C0)
    logit = np.log(INITIAL_OPACITY / (1 - INITIAL_OPACITY))
    return Splats(
        np.ascontiguousarray(points, np.float32),
        np.repeat(np.log(SPACING_SCALE * spacing)[:, None], 3, axis=1).astype(np.float32),
        quats,
        np.full(count, logit, np.float32),
        sh,
    )
