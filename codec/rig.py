"""What the poses of several cameras say together: where they look, and which way is up."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from .camera import Camera
from .pose import Doubles


def closest_point(cameras: Sequence[Camera], least_spread: float) -> Doubles | None:
    """(3,) the point closest to all viewing axes, metres; None unless it is in front of them all.

    Least squares: the squared distance of x to the axis (c, d) is |(I - d d^T)(x - c)|^2, so x
    solves sum(I - d d^T) x = sum((I - d d^T) c).

    least_spread: parallel axes are close to each other everywhere and meet nowhere, so there is no
    point either where the mean squared sine of the axes to some common direction is below this.
    """
    if not cameras:
        return None
    positions = np.array([camera.position for camera in cameras])  # (C, 3)
    axes = np.array([camera.forward for camera in cameras])  # (C, 3)
    projectors = np.eye(3) - axes[:, :, None] * axes[:, None, :]  # (C, 3, 3)
    system = projectors.sum(axis=0)
    # v^T (I - d d^T) v is the squared sine between v and d: the smallest eigenvalue is their sum.
    if np.linalg.eigvalsh(system)[0] < least_spread * len(cameras):
        return None
    point: Doubles = np.linalg.solve(system, np.einsum("cij,cj->i", projectors, positions))
    depths = ((point - positions) * axes).sum(axis=1)
    return point if float(depths.min()) > 0 else None


def mean_up(cameras: Sequence[Camera]) -> Doubles:
    """(3,) unit vector in the world: where the tops of the cameras' pictures point on average.

    Where they point everywhere and cancel out, the first camera tells.
    """
    tops = -np.array([camera.down for camera in cameras])
    up: Doubles = tops.mean(axis=0)
    if not float(np.linalg.norm(up)) > 1e-3:
        up = tops[0]
    unit: Doubles = up / np.linalg.norm(up)
    return unit
