"""The rigs that the process of mapping.py found, whether unseen moments bear them out, and their
world.

Two rigs of the same cameras are compared after the similarity that brings most cameras of one onto
the other. The world of a rig has z up, its origin in the middle of what all cameras see, and a unit
in metres where one is known.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components
from scipy.spatial.distance import pdist
from scipy.spatial.transform import Rotation

from codec.arrays import Doubles, Flags, Longs
from codec.camera import Camera
from codec.rig import rig_centre, rig_up

from .mapping import LENSES


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
    rotation = Rotation.from_matrix(turns[close]).mean().as_matrix()
    a, b = centres(poses), centres(onto)
    lengths = pdist(a)
    counts = lengths > 1e-9 * max(lengths.max(), 1e-300)
    scale = float(np.median(pdist(b)[counts] / lengths[counts]))
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


Pair = tuple[int, int]

UNSEEN_PX = 3.0
"""Largest median error, at 640 pixels of width, of points of unseen moments in a right rig; and how
far the rays of a point may miss each other for its place to be believed."""

PASSES = 3
"""How often wrong cameras are looked for, without those that were found before: one that is wrong
spoils all points that it shares."""

LEAST_BASE = 0.02
"""Least squared sine of the angles between the rays of a track: with less, its depth is noise."""


@dataclass(frozen=True, slots=True, eq=False)
class Rig:
    """A rig as it was solved. NaN for the cameras that are not in it."""

    lenses: Doubles  # (C, 4) focal length, principal point, pixels; radial term
    poses: Doubles  # (C, 3, 4) world to camera
    points: Doubles  # (P, 3)
    seen: Longs  # (N, 3) of each observation the point, the camera and its keypoint

    @property
    def has(self) -> Flags:
        """(C,) whether a camera is in the rig."""
        found: Flags = np.isfinite(self.poses[:, 0, 0])
        return found

    def rays(self, camera: int, xy_px: Doubles) -> Doubles:
        """(N, 3) directions in the world of pixels (N, 2)."""
        focal_px, cx_px, cy_px, k1 = self.lenses[camera]
        bent: Doubles = (xy_px - (cx_px, cy_px)) / focal_px
        straight = bent
        for _ in range(10):
            straight = bent / (1 + k1 * (straight**2).sum(axis=1, keepdims=True))
        local = np.column_stack([straight, np.ones(len(straight))])
        local /= np.linalg.norm(local, axis=1, keepdims=True)
        rays: Doubles = local @ self.poses[camera, :, :3]
        return rays


@dataclass(frozen=True, slots=True, eq=False)
class Solution:
    """All rigs, and what they were made of."""

    keypoints: list[Doubles]
    """(N, 3) of each camera: x and y in pixels, and the moment."""
    moved_px: Doubles
    """(C, M) by how much the still part of each moment's picture lies elsewhere than in the middle
    moment's; NaN where that cannot be told."""
    matches: Mapping[str, Mapping[Pair, Longs]]
    """(N, 2) verified keypoints of each pair of cameras, by name of a half: "first" or "second"."""
    rigs: Mapping[tuple[str, str], Rig]
    """By that name or "whole" and the kind of lens; rigs that were not found are missing."""


def read_solution(path: Path, num_cameras: int) -> Solution:
    """The result.npz of mapping.py."""
    with np.load(path) as file:
        arrays = dict(file)
    matches: dict[str, dict[Pair, Longs]] = {"first": {}, "second": {}}
    for key, value in arrays.items():
        if key.startswith("matches_"):
            _, name, a, b = key.split("_")
            matches[name][int(a), int(b)] = value
    rigs = {
        (name, lens): Rig(*(arrays[f"{name}_{lens}_{key}"] for key in Rig.__dataclass_fields__))
        for name in (*matches, "whole")
        for lens in LENSES
        if f"{name}_{lens}_poses" in arrays
    }
    keypoints = [arrays[f"keypoints{camera}"].astype(np.float64) for camera in range(num_cameras)]
    moved_px = arrays.get("moved", np.full((num_cameras, 0), np.nan))
    return Solution(keypoints, moved_px, matches, rigs)


def unseen_errors(solution: Solution, lens: str, widths_px: Sequence[int]) -> list[Doubles]:
    """Of each camera, in pixels: how far points of the moments of each half, placed by the other
    cameras of the other half's rig, lie from where this camera saw them."""
    limits_px = UNSEEN_PX * np.maximum(1, np.array(widths_px) / 640)
    found: dict[int, Doubles] = {}
    for _ in range(PASSES):
        parts: list[list[Doubles]] = [[np.zeros(0)] for _ in solution.keypoints]
        for half, other in (("first", "second"), ("second", "first")):
            rig = solution.rigs.get((half, lens))
            if rig is None:
                continue
            matches = {p: m for p, m in solution.matches[other].items() if not found.keys() & p}
            errors, cameras = _left_out(rig, solution.keypoints, matches, limits_px)
            for camera, of_camera in enumerate(parts):
                of_camera.append(errors[cameras == camera])
        joined = [np.concatenate(of_camera) for of_camera in parts]
        wrong = {
            i: errors
            for i, errors in enumerate(joined)
            if len(errors) and np.median(errors) > limits_px[i]
        }
        found |= wrong
        if not wrong:
            break
    return [found.get(i, errors) for i, errors in enumerate(joined)]


def _left_out(
    rig: Rig, keypoints: list[Doubles], matches: Mapping[Pair, Longs], limits_px: Doubles
) -> tuple[Doubles, Longs]:
    """(errors in pixels, cameras) of observations: each of a track of three or more, whose others
    agree on a place."""
    starts = np.concatenate([[0], np.cumsum([len(k) for k in keypoints])])
    pairs = {p: m for p, m in matches.items() if rig.has[p[0]] and rig.has[p[1]]}
    none = np.zeros(0), np.zeros(0, np.int64)
    if not pairs:
        return none
    edges = np.concatenate([m + starts[[a, b]] for (a, b), m in pairs.items()])
    graph = coo_matrix((np.ones(len(edges)), edges.T), shape=(starts[-1], starts[-1]))
    track = connected_components(graph, directed=False)[1].astype(np.int64)
    used = np.unique(edges)
    camera = np.searchsorted(starts, used, side="right") - 1
    track = np.unique(track[used], return_inverse=True)[1]
    size = np.bincount(track)
    distinct = np.bincount(np.unique(np.stack([track, camera]), axis=1)[0], minlength=len(size))
    kept = ((size >= 3) & (size == distinct))[track]
    used, camera, track = used[kept], camera[kept], track[kept]
    if not len(used):
        return none
    rays = np.zeros((len(used), 3))
    for one in np.unique(camera):
        mine = camera == one
        rays[mine] = rig.rays(one, keypoints[one][used[mine] - starts[one], :2])
    origins = centres(rig.poses)[camera]
    # The place nearest to the rays of the others: sum (I - r r^T) (x - o) = 0.
    across = np.eye(3) - rays[:, :, None] * rays[:, None, :]
    reached = np.einsum("nij,nj->ni", across, origins)
    squares = np.einsum("ni,ni->n", origins, reached)
    others, others_reached, others_squares = (
        _sums(each, track) - each for each in (across, reached, squares)
    )
    count = np.bincount(track)[track] - 1
    base = np.linalg.eigvalsh(others)[:, 0] / count
    sound = base >= LEAST_BASE
    place = np.full((len(used), 3), np.nan)
    place[sound] = np.linalg.solve(others[sound], others_reached[sound, :, None])[..., 0]
    missed = np.einsum("ni,nij,nj->n", place, others, place) + others_squares
    missed = np.sqrt(np.maximum((missed - 2 * np.einsum("ni,ni->n", place, others_reached)), 0))
    away = np.linalg.norm(place - origins, axis=1)
    focal_px = rig.lenses[camera, 0]
    agreed = sound & (missed / np.sqrt(count) / away * focal_px <= limits_px[camera])
    offset = np.einsum("nij,nj->ni", across, place - origins)
    ahead = np.einsum("ni,ni->n", rays, place - origins)
    error_px = focal_px * np.linalg.norm(offset, axis=1) / np.maximum(ahead, 1e-9)
    error_px[ahead <= 0] = np.inf
    return error_px[agreed], camera[agreed]


def _sums(values: Doubles, track: Longs) -> Doubles:
    """Sums of the values over each track, for each of its members."""
    sums = np.zeros((track.max() + 1, *values.shape[1:]))
    np.add.at(sums, track, values)
    gathered: Doubles = sums[track]
    return gathered


UNKNOWN_DISTANCE = 3.0
"""Distance from the cameras to the origin where nothing gives the unit: that of a small studio in
metres, so that what is meant for metres is of the right order."""

FLOOR_TILT_DEG = 12.0
"""Most by which a floor may be off the cameras' up: rigs are rarely held straighter."""

FLOOR_SHARE, BELOW_SHARE, THICKNESS = 0.1, 0.04, 0.01
"""A floor has at least this share of the points, at most that share lies below it, and it is so
thick, over the distance of the cameras."""

TRIES, MOST_POINTS = 500, 5000
"""Planes that are tried, and points that they are compared with."""


def world_of(
    cameras: Sequence[Camera], points: Doubles, scale: float | None
) -> tuple[Similarity, bool]:
    """The similarity into a world with z up, its origin in the middle of what all cameras see; and
    whether its z comes from a floor, and not from how the cameras are held.

    points: (P, 3). scale: metres of a unit; None if that is not known.
    """
    centre = rig_centre(cameras)
    if centre is None:
        centre = np.median(points, axis=0)
    places = np.array([camera.position for camera in cameras])
    distance = float(np.median(np.linalg.norm(places - centre, axis=1)))
    up = rig_up(cameras)
    floor = floor_normal(points, up, distance)
    up = up if floor is None else floor
    # x points away from the first camera, so that equal rigs get equal worlds.
    x = np.cross(centre - places[0], up)
    if np.linalg.norm(x) < 1e-6 * distance:
        x = np.cross(np.eye(3)[int(np.argmin(np.abs(up)))], up)
    x /= np.linalg.norm(x)
    rotation = np.stack([x, np.cross(up, x), up])
    scale = UNKNOWN_DISTANCE / distance if scale is None else scale
    return Similarity(scale, rotation, -scale * rotation @ centre), floor is not None


def floor_normal(points: Doubles, up: Doubles, distance: float) -> Doubles | None:
    """(3,) the upward unit normal of the plane that many points (P, 3) lie in and next to none
    below; None if there is none within FLOOR_TILT_DEG of `up`."""
    if len(points) < 50:
        return None
    rng = np.random.default_rng(0)
    points = rng.permutation(points)[:MOST_POINTS]
    thickness = THICKNESS * distance
    a, b, c = points[rng.integers(len(points), size=(3, TRIES))]
    normals = np.cross(b - a, c - a)
    normals *= np.sign(normals @ up)[:, None]
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-300)
    heights = points @ normals.T - (a * normals).sum(axis=1)
    on = np.abs(heights) < thickness
    counts = on.sum(axis=0)
    counts[normals @ up < np.cos(np.radians(FLOOR_TILT_DEG))] = 0
    counts[(heights < -3 * thickness).mean(axis=0) >= BELOW_SHARE] = 0
    best = int(np.argmax(counts))
    if counts[best] <= FLOOR_SHARE * len(points):
        return None
    plane = points[on[:, best]]
    normal = np.linalg.svd(plane - plane.mean(axis=0), full_matrices=False)[2][2]
    found: Doubles = normal * np.sign(normal @ up)
    return found


def metres_of_unit(cameras: Sequence[Camera], one: str, other: str, metres: float) -> float:
    """Metres of a unit of the rig, of the distance between two cameras."""
    places = {camera.name: camera.position for camera in cameras}
    return metres / float(np.linalg.norm(places[one] - places[other]))
