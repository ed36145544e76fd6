"""Errors of Gaussians against the originals, independent of the order of Gaussians and axes."""

from __future__ import annotations

import itertools
import math
from dataclasses import replace

import numpy as np
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from codec.arrays import Doubles
from codec.splats import SH_C0, Splats
from tests.support.drawn import angles_rad
from tests.support.trained_like import covariances

KINDS = ("position, mm", "ln size", "rotation, rad", "opacity", "colour")
FAINT = 4 / 255
"""Opacity up to which Gaussians are left out, because formats may drop or keep them."""
FLAT = math.log(1e-4)
"""Logarithm of the minimum standard deviation, metres; smaller ones count as this one."""


def _shown_colours(splats: Splats) -> Doubles:
    """(N, 3) drawn colours, clipped to 0..1, because some formats store no others."""
    return np.clip(0.5 + SH_C0 * splats.sh[:, 0].astype(np.float64), 0, 1)


def _features(splats: Splats) -> Doubles:
    """(N, 10) numbers that distinguish Gaussians, in units of the formats' errors."""
    sizes = np.sort(np.maximum(splats.log_scales, FLAT), axis=1)
    looks = _shown_colours(splats), splats.opacities[:, None]
    parts = splats.means / 1e-3, sizes / 0.1, *(values / 0.02 for values in looks)
    return np.concatenate(parts, axis=1)


def axis_turns() -> list[Doubles]:
    """The 24 rotations that map axes to axes."""
    found = []
    for order in itertools.permutations(range(3)):
        for signs in itertools.product((-1, 1), repeat=3):
            turn = np.eye(3)[list(order)] * np.array(signs)[:, None]
            if np.linalg.det(turn) > 0:
                found.append(turn)
    return found


def shapes(splats: Splats) -> Doubles:
    """(N, 3, 3) covariances."""
    return covariances(splats.log_scales.astype(np.float64), splats.quats.astype(np.float64))


def _closest_shapes(found: Splats, wanted: Splats) -> tuple[Doubles, Doubles]:
    """(N,) angles between orientations in radians and (N, 3) differences of ln sizes. The axes of
    each Gaussian are permuted so that both are small, because their order has no visible effect."""
    sizes = [np.maximum(splats.log_scales, FLAT) for splats in (found, wanted)]
    best = np.full(len(found), np.inf)
    angles, differences = np.zeros(len(found)), np.zeros((len(found), 3))
    turned = Rotation.from_quat(found.quats[:, [1, 2, 3, 0]])
    for turn in axis_turns():
        # The axis that each axis comes from.
        axes = np.abs(turn).argmax(axis=0).tolist()
        quats = (turned * Rotation.from_matrix(turn)).as_quat()[:, [3, 0, 1, 2]].astype(np.float32)
        angle = angles_rad(replace(found, quats=quats), wanted)
        difference = sizes[0][:, axes] - sizes[1]
        cost = angle + np.abs(difference).max(axis=1)
        rows = np.flatnonzero(cost < best)
        best[rows], angles[rows], differences[rows] = cost[rows], angle[rows], difference[rows]
    return angles, differences


def largest_errors(found: Splats, wanted: Splats) -> Doubles:
    """(5,) largest error of each of KINDS, over all Gaussians of `found` that are not too faint,
    each compared with the most similar Gaussian of `wanted`."""
    found = found.take(np.flatnonzero(found.opacities > FAINT))
    match = wanted.take(cKDTree(_features(wanted)).query(_features(found))[1])
    angles, sizes = _closest_shapes(found, match)
    differences = (
        1e3 * (found.means - match.means),
        sizes,
        angles,
        found.opacities - match.opacities,
        _shown_colours(found) - _shown_colours(match),
    )
    return np.array([np.abs(values).max() for values in differences])
