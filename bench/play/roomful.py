"""A room full of random Gaussians for the player's benches."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from codec.arrays import Longs
from codec.camera import Camera
from codec.lattice.lattice import Lattice
from codec.slice import Slice
from codec.splats import Splats, sh_count
from codec.stream.manifest import Manifest

SWIN_SIZE = 5
RUN_ROWS = 500
"""Length of a run of rows that change together."""


def manifest_of(num_gs: int, width_px: int, height_px: int, sh_degree: int = 0) -> Manifest:
    """The manifest of a stream of `num_gs` Gaussians a frame."""
    focal_px = 0.9 * width_px
    size = (width_px, height_px, focal_px, focal_px, width_px / 2, height_px / 2)
    return Manifest(
        fps=30.0,
        swin_size=SWIN_SIZE,
        slots=(num_gs // SWIN_SIZE,),
        lattice=(Lattice(0.01, 1 / 8, 1 / 60, 1 / 20, 41),),
        segment_frames=30,
        sh_degree=sh_degree,
        antialias=False,
        near_m=0.2,
        bounds=((-3.0, -2.0, 0.0), (3.0, 2.0, 6.0)),
        cameras=(Camera("front", *size, np.eye(4)),),
        default_camera="front",
        live=False,
    )


def slice_of(birth: int, count: int, total: int, sh_degree: int = 0) -> Slice:
    """`count` of the `total` Gaussians of a room; they are smaller if `total` is larger."""
    rng = np.random.default_rng(birth + 100)
    arrays = (
        rng.uniform(-1, 1, (count, 3)) * (3, 2, 3) + (0, 0, 3),
        rng.normal(np.log(1.2 / total ** (1 / 2.2)), 0.7, (count, 3)),
        rng.normal(size=(count, 4)),
        rng.normal(0, 2, count),
        rng.normal(0, 0.6, (count, sh_count(sh_degree), 3)),
    )
    splats = Splats(*(array.astype(np.float32) for array in arrays))
    return Slice(birth, splats, np.zeros(count, np.uint8))


def first_window(manifest: Manifest) -> list[Slice]:
    """The slices that frame 0 shows."""
    births = range(1 - manifest.swin_size, 1)
    size = manifest.slice_size, manifest.num_gs, manifest.sh_degree
    return [slice_of(birth, *size) for birth in births]


def changed_slice(birth: int, share: float, scattered: bool, manifest: Manifest) -> Slice:
    """A slice that changes `share` of its lane's rows, scattered or in runs."""
    size = manifest.slice_size
    rng = np.random.default_rng(birth)
    together = 1 if scattered else min(RUN_ROWS, size)
    runs = size // together
    chosen = np.sort(rng.choice(runs, max(1, round(runs * share)), replace=False))
    rows: Longs = (chosen[:, None] * together + np.arange(together)).ravel()
    whole = slice_of(birth, len(rows), manifest.num_gs)
    return replace(whole, rows=rows.astype(np.int32))
