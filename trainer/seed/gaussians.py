"""The first Gaussians: a capture's own points, and seeds as deep as stereo finds them; and how near
the nearest of them stand to the cameras.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from codec.arrays import Bytes, Floats
from codec.camera import Camera, Floating
from codec.kernel import kernel
from codec.splats import SH_C0, Splats, sh_count
from trainer.capture.points import depths_in_view

from .stereo import agreed_places, completed, depth_maps

STRAY_SHARE = 0.005
"""Share of what a camera sees that may lie nearer than the nearest thing: matches go astray."""

MIN_STRAYS = 5
"""How many may at least: of few points one share is less than a point."""

MIN_IN_VIEW = 64
"""With fewer places in its view, a camera gives no nearest depth."""

AGREEING = 2
"""Neighbours that have to agree on the depth of a pixel."""


def nearest_seen(cameras: Sequence[Camera], places: Floating) -> float | None:
    """Depth of the nearest of the `places` (P, 3), metres, world, that any camera sees, metres.

    What hides a place from a camera stands nearer still, so that all in a camera's view count.
    STRAY_SHARE of them, the nearest, do not. None where no camera has enough places in view.
    """
    nearest = []
    for camera in cameras:
        depths = depths_in_view(camera, places)
        if len(depths) >= MIN_IN_VIEW:
            strays = max(MIN_STRAYS, int(STRAY_SHARE * len(depths)))
            nearest.append(float(np.partition(depths, strays)[strays]))
    return min(nearest, default=None)


def share_nearer(camera: Camera, places: Floating, near_m: float) -> float:
    """Share of the `places` in the camera's view that lie nearer than `near_m`; 0 if it has too
    few."""
    depths = depths_in_view(camera, places)
    return float((depths < near_m).mean()) if len(depths) >= MIN_IN_VIEW else 0.0


def stereo_places(
    cameras: Sequence[Camera],
    pictures: Sequence[Bytes],
    near_m: float,
    far_m: float,
) -> Floats:
    """(P, 3) float32, metres, world: what the cameras agree on between near_m and far_m.

    pictures: one (H, W, 3) uint8 per camera. Left out is what lies at the nearest depth tried: it
    may be nearer still, and without texture every depth fits.
    """
    maps = depth_maps(cameras, pictures, near_m, far_m)
    maps.agreeing[maps.depths <= near_m * (1 + 1e-3)] = 0
    return agreed_places(maps, AGREEING)


INITIAL_OPACITY = 0.5
"""3DGS-MCMC's start: opaque enough to get gradients, not so much that it hides others."""

SPACING_SCALE = 0.5
"""Initial standard deviation over the distance to the nearest neighbours."""

FIRST_CANDIDATES = 8
"""How many of the nearest places the tree is asked for at first; the point's own is one of them."""

ROUNDING = 1e-6
"""More than the relative error of a squared distance in float32, unless that underflows."""


def stereo_seeds(
    cameras: Sequence[Camera],
    pictures: Sequence[Bytes],
    count: int,
    near_m: float,
    far_m: float,
    rng: np.random.Generator,
    masks: Sequence[Bytes | None] | None = None,
) -> tuple[Floats, Bytes]:
    """`count` points behind random places of random pictures, as deep as plane-sweep stereo says.

    Where the cameras do not agree on a depth it is filled from around: a smooth wall at about the
    right depth trains into the right one, while seeds at random depths train into haze. pictures:
    one (H, W, 3) uint8 per camera; masks: (H, W) each, 0 where no point may lie. Gives positions
    (count, 3) float32, metres, world, and colours (count, 3) uint8; none when no three cameras
    agree on anything.
    """
    allowed = [None if mask is None else np.flatnonzero(mask) for mask in masks or ()]
    allowed += [None] * (len(cameras) - len(allowed))
    # Ignored pixels must not place anything: black agrees with black only.
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


@kernel()
def _three_least(places, copies, rows, candidates):  # type: ignore[no-untyped-def]
    """(R, 3) float32, ascending: squared distances of a point at each of the places `rows` to the
    three nearest other points.

    places (P, 3) float32, with copies[i] points at the i-th; candidates (R, K): the places to look
    at for each row, its own among them.
    """
    least = np.empty((len(rows), 3), np.float32)
    for r in range(len(rows)):
        i = rows[r]
        a = b = c = np.float32(np.inf)
        for j in candidates[r]:
            dx = places[i, 0] - places[j, 0]
            dy = places[i, 1] - places[j, 1]
            dz = places[i, 2] - places[j, 2]
            d = dx * dx + dy * dy + dz * dz
            others = copies[j] - 1 if i == j else copies[j]
            for _ in range(min(3, others)):
                if d < a:
                    a, b, c = d, a, b
                elif d < b:
                    b, c = d, b
                elif d < c:
                    c = d
        least[r] = a, b, c
    return least


def spacings(points: Floats) -> Floats:
    """(N,) float32: the root mean square distance of every point to its three nearest others.

    points: (N, 3) float32, N at least 4. The result is bit for bit that of comparing all pairs in
    float32. A tree finds the candidates, in float64. Where rounding to float32 could make a place
    beyond them one of the three nearest, the tree is asked for twice as many.
    """
    from scipy.spatial import cKDTree  # loads slowly, and most commands do without it

    # Points that coincide are one place in the tree, which is slow where it holds many of them.
    places, which, copies = np.unique(points, axis=0, return_inverse=True, return_counts=True)
    tree = cKDTree(places)
    result = np.empty(len(places), np.float32)
    rows, count = np.arange(len(places)), FIRST_CANDIDATES
    while len(rows):
        count = min(count, len(places))
        distances, candidates = tree.query(places[rows], np.arange(1, count + 1))
        least = _three_least(places, copies, rows, candidates)
        result[rows] = np.sqrt((least[:, 0] + least[:, 1] + least[:, 2]) / np.float32(3))
        doubtful = least[:, 2] > (1 - ROUNDING) * np.square(distances[:, -1])
        rows = rows[doubtful & (count < len(places))]
        count *= 2
    return result[which.reshape(-1)]  # NumPy 2.0 gives it as (N, 1)


def initial_splats(points: Floats, colours: Bytes, sh_degree: int) -> Splats:
    """Round Gaussians at `points` (N, 3), coloured by `colours` (N, 3), sized by their spacing."""
    count = len(points)
    spacing = spacings(points) if count > 3 else np.full(count, 0.1, np.float32)
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
