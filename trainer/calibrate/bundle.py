"""Bundle adjustment with a prior for lenses: those of one kind are alike, and principal points lie
near the middle.

A principal point can stand in for a turn of its camera and a focal length for its distance, so that
a camera with few points is turned and moved by their noise. pycolmap's adjustment knows no such
prior: it holds lenses, or leaves them free.

Levenberg and Marquardt's steps; points are eliminated (Triggs et al., "Bundle Adjustment - A Modern
Synthesis", 2000, section 6.1).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy import sparse
from scipy.spatial.transform import Rotation

from codec.arrays import Doubles, Flags, Longs

NOISE_PX = 0.5
"""Error of a keypoint, at 640 pixels of width."""

CENTRE_SPREAD, FOCAL_SPREAD, RADIAL_SPREAD = 0.007, 0.006, 0.01
"""How far principal points lie from the middle, over the longer side, and focal lengths, over their
mean, and radial terms from theirs: means of a kind."""

FOCAL_UNKNOWN, RADIAL_UNKNOWN = 0.5, 0.3
"""How far all those of a kind may be from what was found before."""

FILTER_PX = (2.0, 1.5)
"""Reprojection errors over which observations are dropped after each adjustment, at 640 pixels of
width."""

LEAST_ANGLE_DEG = 1.5
"""Points whose rays meet at less are dropped."""

MAX_STEPS, LEAST_GAIN = 40, 1e-6
"""Steps of an adjustment, and the share of the cost that one must gain for another to follow."""

START_DAMPING, MAX_DAMPING, DAMPING_RATIO = 1e-4, 1e6, 5.0
"""Damping of the first step over the diagonal of its equations; where the search ends; and the
factor by which damping falls after a step that gains, and rises after one that does not."""

POSE, LENS = 6, 4
"""Unknowns of a camera: turn and offset, and those of its lens (see `solution.Rig`)."""


@dataclass(frozen=True, slots=True, eq=False)
class Bundle:
    """Cameras, points, and where cameras see them."""

    lenses: Doubles  # (C, 4) focal length, principal point, pixels; radial term
    poses: Doubles  # (C, 3, 4) world to camera
    points: Doubles  # (P, 3)
    cameras: Longs  # (N,) of each observation
    seen: Longs  # (N,) its point
    keypoints: Longs  # (N,) its number among those of the camera
    xy_px: Doubles  # (N, 2)

    def local(self) -> Doubles:
        """(N, 3) observed points as their cameras have them."""
        turned = np.einsum("nij,nj->ni", self.poses[self.cameras, :, :3], self.points[self.seen])
        found: Doubles = turned + self.poses[self.cameras, :, 3]
        return found

    def misses_px(self) -> Doubles:
        """(N, 2) where points are drawn, less where they are seen."""
        x, y, z = self.local().T
        focal, cx, cy, radial = self.lenses[self.cameras].T
        bent = focal * (1 + radial * (x**2 + y**2) / z**2) / z
        return np.column_stack([bent * x + cx, bent * y + cy]) - self.xy_px

    def moved(self, cameras: Doubles, points: Doubles) -> Bundle:
        """After a step of cameras (C, 10) and points (P, 3)."""
        poses = self.poses.copy()
        poses[:, :, :3] = Rotation.from_rotvec(cameras[:, :3]).as_matrix() @ poses[:, :, :3]
        poses[:, :, 3] += cameras[:, 3:POSE]
        lenses = self.lenses + cameras[:, POSE:]
        return replace(self, lenses=lenses, poses=poses, points=self.points + points)

    def kept(self, fits: Flags) -> Bundle:
        """With those observations (N,) alone, and without points that less than two cameras see or
        whose rays are as good as parallel."""
        local = self.local()
        rays = np.einsum("nji,nj->ni", self.poses[self.cameras, :, :3], local)
        rays /= np.linalg.norm(rays, axis=1, keepdims=True)
        which = np.flatnonzero(fits)
        order = which[np.argsort(self.seen[which], kind="stable")]
        points, first, each = np.unique(self.seen[order], return_index=True, return_inverse=True)
        cosines = (rays[order] * rays[order[first]][each]).sum(axis=1)
        least = np.ones(len(points))
        np.minimum.at(least, each, cosines)
        stays = least < np.cos(np.radians(LEAST_ANGLE_DEG))  # a point of one ray has a cosine of 1
        order, each = order[stays[each]], each[stays[each]]
        return replace(
            self,
            points=self.points[points[stays]],
            cameras=self.cameras[order],
            seen=(np.cumsum(stays) - 1)[each],
            keypoints=self.keypoints[order],
            xy_px=self.xy_px[order],
        )


def adjusted(
    bundle: Bundle, kinds: Sequence[int], sizes_px: Sequence[tuple[int, int]], scale: float
) -> Bundle:
    """The likeliest bundle by what cameras see and by the prior of their lenses, without
    observations that lie off.

    kinds: of each camera, the kind whose lenses are alike; scale: size of the pictures over 640
    pixels of width.
    """
    prior = LensPrior(bundle.lenses, kinds, sizes_px)
    for limit_px in FILTER_PX:
        bundle = _fitted(bundle, prior, NOISE_PX * scale)
        misses_px = np.linalg.norm(bundle.misses_px(), axis=1)
        bundle = bundle.kept((misses_px < limit_px * scale) & (bundle.local()[:, 2] > 0))
    return bundle


class LensPrior:
    """A normal distribution of the lenses of all cameras."""

    def __init__(
        self, lenses: Doubles, kinds: Sequence[int], sizes_px: Sequence[tuple[int, int]]
    ) -> None:
        sizes = np.array(sizes_px, float)
        number = len(lenses)
        self._means = np.column_stack([lenses[:, 0], sizes / 2, lenses[:, 3]])
        self.weights = np.zeros((number, LENS, number, LENS))
        """Half of the second derivatives of `cost`."""
        same = np.array(kinds)[:, None] == np.array(kinds)
        # A kind may have any mean: only what lenses deviate from it counts.
        deviates = np.eye(number) - same / same.sum(axis=1)
        focal = same @ lenses[:, 0] / same.sum(axis=1)
        for i, unit, spread, unknown in (
            (0, focal, FOCAL_SPREAD, FOCAL_UNKNOWN),
            (3, np.ones(number), RADIAL_SPREAD, RADIAL_UNKNOWN),
        ):
            relative = deviates / spread**2 + np.eye(number) / unknown**2
            self.weights[:, i, :, i] = relative / unit / unit[:, None]
        centre = np.diag(1 / (CENTRE_SPREAD * sizes.max(axis=1)) ** 2)
        self.weights[:, 1, :, 1] = self.weights[:, 2, :, 2] = centre

    def slopes(self, lenses: Doubles) -> Doubles:
        """(C, 4) half of the first derivatives of `cost`."""
        found: Doubles = np.einsum("aibj,bj->ai", self.weights, lenses - self._means)
        return found

    def cost(self, lenses: Doubles) -> float:
        """How unlikely lenses (C, 4) are: twice the logarithm."""
        return float(((lenses - self._means) * self.slopes(lenses)).sum())


def _fitted(bundle: Bundle, prior: LensPrior, noise_px: float) -> Bundle:
    """The bundle of least cost: squares of errors that are small, sizes of large ones."""

    def cost(tried: Bundle) -> float:
        errors = (tried.misses_px() ** 2).sum(axis=1) / (2 * noise_px) ** 2
        return float(8 * (np.sqrt(1 + errors) - 1).sum()) + prior.cost(tried.lenses)

    damping, now = START_DAMPING, cost(bundle)
    for _ in range(MAX_STEPS):
        equations = _Equations(bundle, prior, noise_px)
        while True:
            tried = bundle.moved(*equations.step(damping))
            then = cost(tried)
            if then < now or damping > MAX_DAMPING:
                break
            damping *= DAMPING_RATIO
        if not then < now:
            break
        gained, bundle, now = now - then, tried, then
        damping /= DAMPING_RATIO
        if gained < LEAST_GAIN * now:
            break
    return bundle


class _Equations:
    """Gauss and Newton's equations at a bundle: of cameras and points, and what ties them."""

    def __init__(self, bundle: Bundle, prior: LensPrior, noise_px: float) -> None:
        misses = bundle.misses_px()
        soft = np.sqrt(1 + (misses**2).sum(axis=1) / (2 * noise_px) ** 2)
        weights = (1 / (soft * noise_px**2))[:, None, None]
        of_cameras, of_points = _slopes(bundle)
        number, self._shape = len(bundle.poses), (len(bundle.poses), POSE + LENS)
        ones, order = np.ones(len(misses)), np.arange(len(misses) + 1)
        by_camera = sparse.csc_matrix((ones, bundle.cameras, order), (number, len(misses)))
        by_point = sparse.csc_matrix((ones, bundle.seen, order), (len(bundle.points), len(misses)))

        def summed(by: sparse.csc_matrix, each: Doubles) -> Doubles:
            found: Doubles = by @ each.reshape(len(each), -1)
            return found.reshape(-1, *each.shape[1:])

        left, errors = (of_cameras * weights).swapaxes(1, 2), misses[:, :, None]
        own = summed(by_camera, left @ of_cameras)
        self._cameras = np.zeros((*self._shape, *self._shape))
        self._cameras[range(number), :, range(number)] = own
        self._cameras[:, POSE:, :, POSE:] += prior.weights
        self._camera_slopes = summed(by_camera, left @ errors)[:, :, 0]
        self._camera_slopes[:, POSE:] += prior.slopes(bundle.lenses)
        below = (of_points * weights).swapaxes(1, 2)
        self._points = summed(by_point, below @ of_points)
        self._point_slopes = summed(by_point, below @ errors).ravel()
        rows = bundle.cameras[:, None] * (POSE + LENS) + np.arange(POSE + LENS)
        columns = bundle.seen[:, None] * 3 + np.arange(3)
        ties = left @ of_points
        at = [np.broadcast_to(a, ties.shape).ravel() for a in (rows[:, :, None], columns[:, None])]
        self._ties = sparse.csr_matrix((ties.ravel(), at))
        # no observation of the last ones: the shape is that of all
        self._ties.resize((number * (POSE + LENS), self._points.shape[0] * 3))

    def step(self, damping: float) -> tuple[Doubles, Doubles]:
        """Moves cameras by (C, 10) and points by (P, 3)."""
        points = self._points * (1 + damping * np.eye(3)) + 1e-12 * np.eye(3)
        number = len(points)
        inverse = sparse.bsr_matrix(
            (np.linalg.inv(points), np.arange(number), np.arange(number + 1))
        )
        through = self._ties @ inverse
        size = self._shape[0] * self._shape[1]
        cameras = self._cameras.reshape(size, size) - (through @ self._ties.T).toarray()
        diagonal = np.einsum("aiai->ai", self._cameras).ravel()
        cameras[range(size), range(size)] += damping * diagonal + 1e-9
        slopes = self._camera_slopes.ravel() - through @ self._point_slopes
        moves = -np.linalg.solve(cameras, slopes)
        moved = -(inverse @ (self._point_slopes + self._ties.T @ moves))
        return moves.reshape(self._shape), moved.reshape(-1, 3)


def _slopes(bundle: Bundle) -> tuple[Doubles, Doubles]:
    """Derivatives of `misses_px` by cameras (N, 2, 10) and points (N, 2, 3)."""
    local = bundle.local()
    x, y = local[:, 0] / local[:, 2], local[:, 1] / local[:, 2]
    focal, _, _, radial = bundle.lenses[bundle.cameras].T
    radius, number = x**2 + y**2, len(local)
    bends = 1 + radial * radius
    by_xy = np.empty((number, 2, 2))
    by_xy[:, 0, 0] = focal * (bends + 2 * radial * x**2)
    by_xy[:, 1, 1] = focal * (bends + 2 * radial * y**2)
    by_xy[:, 0, 1] = by_xy[:, 1, 0] = focal * 2 * radial * x * y
    by_local = np.zeros((number, 2, 3))
    by_local[:, 0, 0] = by_local[:, 1, 1] = 1
    by_local[:, :, 2] = -np.column_stack([x, y])
    by_local = by_xy @ (by_local / local[:, 2, None, None])
    turned = local - bundle.poses[bundle.cameras, :, 3]
    by_turn = np.zeros((number, 3, 3))  # a turn w moves the point t by w x t
    for i, j, k in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
        by_turn[:, i, j], by_turn[:, j, i] = turned[:, k], -turned[:, k]
    of_cameras = np.empty((number, 2, POSE + LENS))
    of_cameras[:, :, :3] = by_local @ by_turn
    of_cameras[:, :, 3:POSE] = by_local
    of_cameras[:, :, POSE] = np.column_stack([bends * x, bends * y])
    of_cameras[:, :, POSE + 1 : POSE + 3] = np.eye(2)
    of_cameras[:, :, POSE + 3] = (focal * radius)[:, None] * np.column_stack([x, y])
    return of_cameras, by_local @ bundle.poses[bundle.cameras, :, :3]
