"""Tile lists: a Gaussian is in the lists of exactly the tiles in which it shows."""

from __future__ import annotations

import numpy as np

from codec.camera import Camera
from player.render.blend import list_tiles, tile_grid
from player.render.project import (
    CONIC_A,
    CONIC_B,
    CONIC_C,
    Q_MAX,
    TILE_PX,
    Projection,
    X,
    Y,
    camera_vector,
    project_kernel,
)

COUNT = 400
CAMERA = Camera("c", 200, 120, 150.0, 150.0, 100.0, 60.0, np.eye(4))


def some_projection(camera: Camera) -> Projection:
    """Needles, specks and walls, some behind the camera or outside the picture."""
    rng = np.random.default_rng(1)
    means = rng.uniform((-3, -2, -0.5), (3, 2, 5), (COUNT, 3)).astype(np.float32)
    log_scales = rng.uniform(-5, -0.5, (COUNT, 3)).astype(np.float32)
    quats = rng.normal(size=(COUNT, 4)).astype(np.float32)
    logits = rng.uniform(-5, 4, COUNT).astype(np.float32)
    projection = Projection.allocate(COUNT)
    project_kernel(
        means, log_scales, quats, logits, np.zeros((COUNT, 1, 3), np.float32),
        np.arange(COUNT, dtype=np.int32), camera_vector(camera, 0.2),
        *tile_grid(camera.width_px, camera.height_px),
        projection.projected, projection.depths, projection.tile_boxes,
    )  # fmt: skip
    return projection


def test_tile_lists_hold_what_shows_and_little_else() -> None:
    tiles_x, tiles_y = tile_grid(CAMERA.width_px, CAMERA.height_px)
    projection = some_projection(CAMERA)
    lists = list_tiles(projection, tiles_x, tiles_y)
    tiles = np.repeat(np.arange(tiles_x * tiles_y), np.diff(lists.starts))
    listed = np.zeros((COUNT, tiles_y, tiles_x), bool)
    listed[lists.gaussians, tiles // tiles_x, tiles % tiles_x] = True
    assert listed.sum() == len(tiles)  # without duplicates

    y, x = np.mgrid[0 : tiles_y * TILE_PX, 0 : tiles_x * TILE_PX] + 0.5
    shows = np.zeros_like(listed)
    in_box = 0
    for i in np.flatnonzero(np.isfinite(projection.depths)):
        p = projection.projected[i].astype(np.float64)
        dx, dy = x - p[X], y - p[Y]
        q = 0.5 * (p[CONIC_A] * dx**2 + p[CONIC_C] * dy**2) + p[CONIC_B] * dx * dy
        by_tile = (q <= p[Q_MAX]).reshape(tiles_y, TILE_PX, tiles_x, TILE_PX).any(axis=(1, 3))
        x0, x1, y0, y1 = projection.tile_boxes[i]
        shows[i, y0:y1, x0:x1] = by_tile[y0:y1, x0:x1]
        in_box += (x1 - x0) * (y1 - y0)
    assert not (shows & ~listed).any()
    assert listed.sum() < 1.02 * shows.sum() < 0.95 * in_box

    # Front to back in every tile; pairs are numbered Gaussian by Gaussian, each once.
    for first, end in zip(lists.starts[:-1], lists.starts[1:], strict=True):
        assert (np.diff(projection.depths[lists.gaussians[first:end]]) >= 0).all()
    assert (np.sort(lists.pairs) == np.arange(len(tiles))).all()
    owner = np.searchsorted(lists.pair_starts, lists.pairs, side="right") - 1
    assert (owner == lists.gaussians).all()


def test_wanted_tiles_have_the_lists_of_all_tiles() -> None:
    tiles_x, tiles_y = tile_grid(CAMERA.width_px, CAMERA.height_px)
    projection = some_projection(CAMERA)
    full = list_tiles(projection, tiles_x, tiles_y)
    wanted = np.zeros((tiles_y, tiles_x), np.bool_)
    wanted[2:4, 5:7] = wanted[6, 1] = True
    some = list_tiles(projection, tiles_x, tiles_y, wanted=wanted)
    assert (np.sort(some.order) == np.flatnonzero(wanted)).all()
    for tile in some.order:
        assert np.array_equal(
            some.gaussians[some.starts[tile] : some.starts[tile + 1]],
            full.gaussians[full.starts[tile] : full.starts[tile + 1]],
        )
    assert len(some.pairs) < 0.5 * len(full.pairs)
    assert (np.sort(some.pairs) == np.arange(len(some.pairs))).all()
    owner = np.searchsorted(some.pair_starts, some.pairs, side="right") - 1
    assert (owner == some.gaussians).all()
    assert np.array_equal(np.sort(full.order), np.arange(tiles_x * tiles_y))
    nothing = list_tiles(projection, tiles_x, tiles_y, wanted=np.zeros_like(wanted))
    assert len(nothing.pairs) == len(nothing.order) == 0
