"""When each take began, by geometry: at the right lags, what moves in one picture lies on the
epipolar lines of what moves in the others. Steps of a walk repeat themselves; places do not."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from codec.arrays import Doubles

from .alignment import centres
from .lags import Curve, Lags, lags_of
from .solution import Rig

PARTNERS, LEAST_ANGLE_DEG, MOST_ANGLE_DEG = 6, 12.0, 110.0
"""Number of cameras that each is compared with, and angles between their views."""

FAR_RAD = np.radians(6)
"""Distances from an epipolar plane count up to this one: farther is something else that moves."""

LEAST_SHARE, LEAST_SAMPLES = 0.25, 20
"""Overlap of two takes that must show movement."""


def geometric_lags(rig: Rig, places_px: Sequence[Doubles], guard: int) -> Lags:
    """The lags of the takes of a rig. places_px: (T, 2) where something moves in each sample, NaN
    where nothing does; guard: as in `lags_of`."""
    rays = [_rays(rig, camera, places) for camera, places in enumerate(places_px)]
    known = [i for i, r in enumerate(rays) if np.isfinite(r[:, 0]).sum() >= LEAST_SAMPLES]
    pairs = set()
    for i in known:
        cosines = rig.poses[:, 2, :3] @ rig.poses[i, 2, :3]
        angles = np.degrees(np.arccos(np.clip(cosines, -1, 1)))
        fit = [j for j in known if LEAST_ANGLE_DEG <= angles[j] <= MOST_ANGLE_DEG]
        nearest = sorted(fit, key=lambda j: abs(angles[j] - 45))[:PARTNERS]
        pairs |= {(min(i, j), max(i, j)) for j in nearest}
    places = centres(rig.poses)
    curves = {(i, j): _curve(places[j] - places[i], rays[i], rays[j]) for i, j in sorted(pairs)}
    found = {pair: curve for pair, curve in curves.items() if curve is not None}
    return lags_of(found, len(rays), guard)


def _rays(rig: Rig, camera: int, xy_px: Doubles) -> Doubles:
    """(T, 3) directions in the world."""
    straight = rig.straightened(camera, xy_px)
    local = np.column_stack([straight, np.ones(len(straight))])
    local /= np.linalg.norm(local, axis=1, keepdims=True)
    rays: Doubles = local @ rig.poses[camera, :, :3]
    return rays


def _curve(base: Doubles, one: Doubles, other: Doubles) -> Curve | None:
    """How much nearer than usual what moves in the other camera lies to the epipolar planes of what
    moves in one, by lag; None if too little moves. base: from one to the other."""
    normals = np.cross(base, one)
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-12)
    away = np.minimum(np.abs(np.arcsin(np.clip(normals @ other.T, -1, 1))), FAR_RAD)
    shifts = np.arange(1 - len(one), len(other))
    found = [np.diagonal(away, int(shift)) for shift in shifts]
    counts = np.array([np.isfinite(each).sum() for each in found])
    enough = (counts >= LEAST_SAMPLES) & (counts >= LEAST_SHARE * counts.max())
    if enough.sum() < 3:
        return None
    costs = np.array([np.nanmean(found[n]) for n in np.flatnonzero(enough)])
    nearer = (np.median(costs) - costs) / FAR_RAD
    return shifts[enough], nearer * np.sqrt(counts[enough] / counts.max())
