"""Estimates from the poses of several cameras: where they look, which way is up, and how deep the
scene is."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence

import numpy as np

from .arrays import Doubles
from .camera import Camera

FORWARD_FACING_RAD = np.radians(30)
"""Axes that all lie within this angle of their mean belong to a forward-facing rig: they hardly
cross, so their crossing says nothing about the scene."""

LEAST_SPREAD = 1e-6
"""See `closest_point`. Forward-facing rigs are out before it counts; what it still stops is a rig
whose cameras face each other along one line."""

LEAST_TURN = 0.01
"""Least mean squared sine between right axes of a rig that tell what is level: 6 degrees."""

MOST_LEAN = np.cos(np.radians(45))
"""Cosine of the angle by which the tops of a rig's pictures may lean on average."""

SAME_SUM = 1.001
"""Ratio of two sums of distances that count as equal: poses are rounded."""

NEAR_FRACTION = 0.35
"""Near plane of an inward rig, in distances from its nearest camera to the centre. Cameras of a
dome sit in its wall, so Gaussians of the wall would stand right before a held-out camera and hide
the scene."""


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


def rig_up(cameras: Sequence[Camera]) -> Doubles:
    """(3,) unit vector in the world that points up.

    It is the direction most square to the right axes of all cameras: whoever films holds a camera
    level, though he tilts it. Where that says nothing, it is the mean of the tops of the pictures:
    if all cameras look the same way, or lie on their side. Where those cancel out, the first one's.
    """
    tops = -np.array([camera.down for camera in cameras])
    mean: Doubles = tops.mean(axis=0)
    if not float(np.linalg.norm(mean)) > 1e-3:
        mean = tops[0]
    mean = mean / np.linalg.norm(mean)
    rights = np.array([camera.right for camera in cameras])  # (C, 3)
    # v^T (r r^T) v is the squared cosine between v and r.
    squares, directions = np.linalg.eigh(rights.T @ rights / len(cameras))
    up: Doubles = directions[:, 0] * np.sign(directions[:, 0] @ mean)
    if squares[1] * squares[2] < LEAST_TURN or up @ mean < MOST_LEAN:
        return mean
    return up


def rig_centre(cameras: Sequence[Camera]) -> Doubles | None:
    """(3,) the point closest to all viewing axes, metres; None for a forward-facing rig, and where
    that point is not in front of every camera."""
    if not cameras:
        return None
    axes = np.array([camera.forward for camera in cameras])  # (C, 3)
    mean = axes.mean(axis=0)
    norm = float(np.linalg.norm(mean))
    if norm > 0 and float((axes @ mean).min()) >= norm * np.cos(FORWARD_FACING_RAD):
        return None
    return closest_point(cameras, LEAST_SPREAD)


def central_camera(cameras: Sequence[Camera]) -> int:
    """The index of the camera that shows a scene best at first: of those with the commonest size of
    picture, the one with the least sum of distances to the others, and of equals the first."""
    sizes = [(camera.width_px, camera.height_px) for camera in cameras]
    commonest = Counter(sizes).most_common(1)[0][0]
    chosen = [index for index, size in enumerate(sizes) if size == commonest]
    positions = np.array([cameras[index].position for index in chosen])
    sums = np.linalg.norm(positions[:, None] - positions[None], axis=2).sum(axis=1)
    return chosen[int(np.argmax(sums <= SAME_SUM * sums.min()))]


def rig_depths(
    cameras: Sequence[Camera], bounds_m: tuple[float, float] | None = None
) -> tuple[float, float] | None:
    """(near, far) in metres that suit every camera of the rig.

    An inward rig is measured: near is 0.35 of the least distance from a camera to the rig's centre;
    far is 1.2 of the largest distance between two cameras, but at least 2 of the largest distance
    to the centre. Any other rig gets `bounds_m`, what the capture itself declares, or None.
    """
    centre = rig_centre(cameras)
    if centre is None:
        return bounds_m
    positions = np.array([camera.position for camera in cameras])
    distances = np.linalg.norm(positions - centre, axis=1)
    span = float(np.linalg.norm(positions[:, None] - positions[None], axis=2).max())
    return NEAR_FRACTION * float(distances.min()), max(1.2 * span, 2 * float(distances.max()))
