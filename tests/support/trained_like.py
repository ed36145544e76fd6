"""Gaussians with the statistics of a trained model: surfaces, thin discs, bimodal opacity.

The distributions follow a trained model of a figure (medians and 10/90 % points of sizes, ratios,
opacities and colours); positions lie on a figure of balls in a room, with a few floaters far away.
"""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from codec.arrays import Doubles
from codec.slice import Slice
from codec.splats import SH_C0, Splats, sh_count

BALLS = (
    # centre in metres, radius in metres
    ((0.0, 0.9, 0.0), 0.30),
    ((0.0, 1.5, 0.0), 0.14),
    ((0.35, 1.1, 0.1), 0.12),
    ((-0.35, 1.1, -0.1), 0.12),
    ((0.15, 0.35, 0.05), 0.16),
    ((-0.15, 0.35, -0.05), 0.16),
    ((1.2, 0.4, 0.8), 0.12),
)
ROOM_M = 3.0
"""Half the width of the room."""


def _facing(normals: Doubles, rng: np.random.Generator) -> Doubles:
    """(N, 4) rotations that turn the z axis to `normals`, with a random turn about it."""
    roll = rng.uniform(0, np.pi, len(normals))
    w = np.sqrt(np.maximum((1 + normals[:, 2]) / 2, 1e-9))
    x, y = -normals[:, 1] / (2 * w), normals[:, 0] / (2 * w)
    cos, sin = np.cos(roll), np.sin(roll)
    return np.stack([w * cos, x * cos + y * sin, y * cos - x * sin, w * sin], axis=1)


def _surface(count: int, rng: np.random.Generator) -> tuple[Doubles, Doubles, Doubles]:
    """(N, 3) points and normals, and (N,) factors of the sizes of Gaussians there."""
    directions = rng.normal(size=(count, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    ball = rng.integers(0, len(BALLS), count)
    centres = np.array([centre for centre, _ in BALLS])[ball]
    radii = np.array([radius for _, radius in BALLS])[ball]
    points, normals, growth = centres + radii[:, None] * directions, directions, np.ones(count)
    in_room = rng.random(count) < 0.4
    wall = np.argmax(np.abs(directions), axis=1)
    sides = np.sign(directions[np.arange(count), wall])
    flat = np.zeros((count, 3))
    flat[np.arange(count), wall] = sides
    on_wall = rng.uniform(-ROOM_M, ROOM_M, (count, 3))
    on_wall[np.arange(count), wall] = sides * ROOM_M
    points = np.where(in_room[:, None], on_wall, points)
    normals = np.where(in_room[:, None], -flat, normals)
    growth = np.where(in_room, 3.0, growth)
    far = rng.random(count) < 0.002
    points[far] *= rng.uniform(5, 40, (far.sum(), 1))
    growth[far] = 20.0
    return points + 0.004 * rng.normal(size=(count, 3)), normals, growth


def trained_like_splats(count: int, seed: int = 0, sh_degree: int = 0) -> Splats:
    """`count` Gaussians that depend only on the arguments."""
    rng = np.random.default_rng(seed)
    points, normals, growth = _surface(count, rng)
    largest = rng.normal(-4.4, 0.7, count) + np.log(growth)
    middle = largest - np.abs(rng.normal(0, 1.9, count))
    smallest = middle - np.abs(rng.normal(0, 1.9, count))
    quats = _facing(normals, rng)
    quats += 0.15 * rng.normal(size=quats.shape)
    quats *= rng.uniform(0.5, 2.0, (count, 1))
    logits = np.where(
        rng.random(count) < 0.6, rng.normal(-2.3, 1.0, count), rng.normal(2, 2, count)
    )
    stripes = 0.5 + 0.3 * np.sin(4 * points @ np.array([1.0, 0.7, 0.4]))
    tint = 0.08 * np.sin(points @ rng.normal(size=(3, 3)))
    rgb = stripes[:, None] + tint + 0.1 * rng.normal(size=(count, 1))
    sh = 0.05 * rng.normal(size=(count, sh_count(sh_degree), 3))
    sh[:, 0] = (rgb - 0.5) / SH_C0
    scales = np.stack([largest, middle, smallest], axis=1)
    return Splats(
        points.astype(np.float32),
        scales.astype(np.float32),
        quats.astype(np.float32),
        np.clip(logits, -8, 8).astype(np.float32),
        sh.astype(np.float32),
    )


def trained_like_slice(birth: int, count: int, sh_degree: int = 0) -> Slice:
    """A slice of trained-like Gaussians; about one in ten starts late."""
    rng = np.random.default_rng(birth + 10_000)
    offsets = np.where(rng.random(count) < 0.1, rng.integers(1, 4, count), 0).astype(np.uint8)
    return Slice(birth, trained_like_splats(count, birth + 500, sh_degree), offsets)


def covariances(log_scales: Doubles, quats: Doubles) -> Doubles:
    """(N, 3, 3) covariances; they are the same for all representations of a Gaussian."""
    axes = Rotation.from_quat(quats[:, [1, 2, 3, 0]]).as_matrix() * np.exp(log_scales)[:, None, :]
    return np.asarray(axes @ axes.transpose(0, 2, 1))
