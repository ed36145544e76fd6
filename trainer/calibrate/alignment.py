"""Two rigs of the same cameras, brought together: which similarity, and by how much they differ."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from codec.arrays import Doubles


@dataclass(frozen=True, slots=True, eq=False)
class Similarity:
    """x -> scale * rotation @ x + offset, of one world into another."""

    scale: float
    rotation: Doubles  # (3, 3)
    offset: Doubles  # (3,)

    def points(self, xyz: Doubles) -> Doubles:
        """The points (..., 3) in the other world."""
        moved: Doubles = self.scale * xyz @ self.rotation.T + self.offset
        return moved

    def poses(self, poses: Doubles) -> Doubles:
        """The poses (C, 3, 4), world to camera, in the other world."""
        turned = poses[:, :, :3] @ self.rotation.T
        moved = self.points(centres(poses))
        return np.concatenate([turned, -(turned @ moved[:, :, None])], axis=2)


def centres(poses: Doubles) -> Doubles:
    """(C, 3) the places of cameras (C, 3, 4), world to camera."""
    found: Doubles = -np.einsum("cji,cj->ci", poses[:, :, :3], poses[:, :, 3])
    return found


def angles_deg(one: Doubles, other: Doubles) -> Doubles:
    """(...) by how much rotations (..., 3, 3) differ."""
    cosines = (np.einsum("...ij,...ij->...", one, other) - 1) / 2
    found: Doubles = np.degrees(np.arccos(np.clip(cosines, -1, 1)))
    return found


def align(poses: Doubles, onto: Doubles) -> Similarity:
    """The similarity that brings most cameras (C, 3, 4) of one rig onto the same ones of another;
    up to half of them may be anywhere. Needs two cameras at least."""
    turns = np.einsum("cji,cjk->cik", onto[:, :, :3], poses[:, :, :3])
    apart = angles_deg(turns[:, None], turns[None])
    best = int(np.argmin(np.median(apart, axis=1)))
    close = apart[best] <= 2 * np.median(apart[best]) + 1e-6
    u, _, vt = np.linalg.svd(turns[close].mean(axis=0))
    rotation = u @ np.diag([1, 1, np.linalg.det(u @ vt)]) @ vt
    a, b = centres(poses), centres(onto)
    pairs = np.triu_indices(len(a), 1)
    lengths = (np.linalg.norm(each[pairs[0]] - each[pairs[1]], axis=1) for each in (a, b))
    shorter, longer = lengths
    counts = shorter > 1e-9 * max(shorter.max(), 1e-300)
    scale = float(np.median(longer[counts] / shorter[counts]))
    offset = np.median(b - scale * a @ rotation.T, axis=0)
    return _refined(a, b, Similarity(scale, rotation, offset))


def _refined(a: Doubles, b: Doubles, start: Similarity) -> Similarity:
    """The similarity that is best for the squares of those cameras that `start` brings near."""
    away = np.linalg.norm(start.points(a) - b, axis=1)
    close = away <= 3 * np.median(away) + 1e-12
    if close.sum() < 3:
        return start
    a, b = a[close], b[close]
    middle_a, middle_b = a.mean(axis=0), b.mean(axis=0)
    u, sizes, vt = np.linalg.svd((b - middle_b).T @ (a - middle_a))
    if sizes[1] < 1e-6 * sizes[0]:  # on a line: places do not tell the turn about it
        return start
    signs = np.array([1, 1, np.sign(np.linalg.det(u @ vt))])
    rotation = u @ np.diag(signs) @ vt
    scale = float((sizes * signs).sum() / ((a - middle_a) ** 2).sum())
    return Similarity(scale, rotation, middle_b - scale * rotation @ middle_a)
