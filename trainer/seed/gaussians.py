"""The first Gaussians: a capture's own points, and seeds as deep as stereo finds them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt
from numba import prange

from codec.camera import Camera
from codec.kernel import kernel
from codec.splats import SH_C0, Splats, sh_count

from .stereo import completed, depth_maps

Floats = npt.NDArray[np.float32]

INITIAL_OPACITY = 0.5
"""3DGS-MCMC's start: opaque enough to get gradients, not so much that it hides others."""

SPACING_SCALE = 0.5
"""Initial standard deviation over the distance to the nearest neighbours."""


def stereo_seeds(
    cameras: Sequence[Camera],
    pictures: Sequence[npt.NDArray[np.uint8]],
    count: int,
    near_m: float,
    far_m: float,
    rng: np.random.Generator,
    masks: Sequence[npt.NDArray[np.uint8] | None] | None = None,
) -> tuple[Floats, npt.NDArray[np.uint8]]:
    """`count` points behind random places of random pictures, as deep as plane-sweep stereo says.

    Where the cameras do not agree on a depth it is filled from around: a smooth wall at about the
    right depth trains into the right one, while seeds at random depths train into haze. pictures:
    one (H, W, 3) uint8 per camera; masks: (H, W) each, 0 where no point may lie. Gives positions
    (count, 3) float32, metres, world, and colours (count, 3) uint8; none when no three cameras
    agree on anything.
    """
    allowed = [None if mask is None else np.flatnonzero(mask) for mask in masks or ()]
    allowed += [None] * (len(cameras) - len(allowed))
    # What is ignored must not tell where anything lies: black agrees with black only.
    shown = [
        picture if mask is None else picture * (mask > 0)[:, :, None]
        for picture, mask in zip(pictures, masks or [None] * len(pictures), strict=True)
    ]
    maps = depth_maps(cameras, shown, near_m, far_m)
    positions, colours = [np.zeros((0, 3), np.float32)], [np.zeros((0, 3), np.uint8)]
    areas_px = np.array(
        [
            c.width_px * c.height_px if places is None else len(places)
            for c, places in zip(cameras, allowed, strict=True)
        ]
    )
    if (maps.agreeing < 2).all() or not areas_px.any():
        return positions[0], colours[0]
    which = rng.choice(len(cameras), count, p=areas_px / areas_px.sum())
    for i, (camera, depths) in enumerate(zip(cameras, completed(maps), strict=True)):
        here = int((which == i).sum())
        x, y = rng.random(here), rng.random(here)  # in a pixel
        places = allowed[i]
        if places is None:
            x, y = x * camera.width_px, y * camera.height_px
        else:
            drawn = places[rng.integers(len(places), size=here)] if here else places[:0]
            x, y = x + drawn % camera.width_px, y + drawn // camera.width_px
        height, width = depths.shape
        behind = depths[
            (y * height / camera.height_px).astype(int), (x * width / camera.width_px).astype(int)
        ]
        positions.append(camera.unproject(x, y, behind).astype(np.float32))
        colours.append(pictures[i][y.astype(int), x.astype(int)])
    return np.concatenate(positions), np.concatenate(colours)


@kernel(parallel=True)
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
    middle = float(np.median(spacing)) if count else 0.0
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
