"""How near to its cameras the nearest things of a scene stand."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from codec.arrays import Bytes, Floats
from codec.camera import Camera, Floating
from trainer.capture.points import depths_in_view

from .stereo import agreed_places, depth_maps

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
