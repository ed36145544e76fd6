"""How far away what a camera sees is, drawn by the CPU renderer with distances as colours."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from codec.arrays import Floats
from codec.camera import Camera
from codec.splats import SH_C0, Splats

from .cpu import render_splats

LEAST_COVERAGE = 0.5
"""Share of a pixel that Gaussians must cover for it to have a depth."""


def render_depth(splats: Splats, camera: Camera, near_m: float) -> Floats:
    """(H, W) float32 depth along the viewing axis, metres: the mean over the Gaussians of a pixel,
    weighted as their colours are; NaN where they cover less than half of it.

    near_m: Gaussians whose centre lies nearer are not drawn, metres.
    """
    axis, distance_m = camera.w2c[2, :3], camera.w2c[2, 3]
    depths_m = np.maximum(splats.means @ axis + distance_m, 0.0)
    values = np.stack([depths_m, np.ones_like(depths_m), np.zeros_like(depths_m)], axis=1)
    sh = ((values - 0.5) / SH_C0).astype(np.float32)[:, None, :]
    picture = render_splats(replace(splats, sh=sh), camera, near_m)
    weighted_m, covered = picture[:, :, 0], picture[:, :, 1]
    depth_m = weighted_m / np.maximum(covered, np.float32(LEAST_COVERAGE))
    depth_m[covered < LEAST_COVERAGE] = np.nan
    return depth_m.astype(np.float32, copy=False)
