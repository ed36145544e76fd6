"""Strategies of hypothesis: Gaussians, directions, rotations, cameras."""

from __future__ import annotations

import math

import numpy as np
from hypothesis import strategies as st

from codec.arrays import Doubles
from codec.camera import Camera, rotation_about, world_to_camera
from codec.splats import Splats, sh_count


@st.composite
def drawn_splats(
    draw: st.DrawFn,
    max_count: int = 20,
    max_degree: int = 3,
    position: float = 1000.0,
    log_scale: tuple[float, float] = (-9.0, 5.0),
    logit: float = 9.0,
    harmonic: float = 1.0,
) -> Splats:
    """Up to `max_count` Gaussians with values uniform within the ranges."""
    count = draw(st.integers(0, max_count))
    degree = draw(st.integers(0, max_degree))
    rng = np.random.default_rng(draw(st.integers(0, 1 << 32)))
    quats = rng.normal(size=(count, 4)) * 10 ** rng.uniform(-3, 3, (count, 1))
    # Some lie on an axis, where components vanish and several are the largest.
    axes = rng.integers(-1, 2, (count, 4))
    on_axis = (rng.random(count) < 0.3) & axes.any(axis=1)
    quats[on_axis] = axes[on_axis]
    return Splats(
        rng.uniform(-position, position, (count, 3)).astype(np.float32),
        rng.uniform(*log_scale, (count, 3)).astype(np.float32),
        quats.astype(np.float32),
        rng.uniform(-logit, logit, count).astype(np.float32),
        rng.uniform(-harmonic, harmonic, (count, sh_count(degree), 3)).astype(np.float32),
    )


def same_splats(a: Splats, b: Splats) -> bool:
    """Whether `a` and `b` have the same bits."""
    pairs = zip(a.arrays, b.arrays, strict=True)
    return all(x.shape == y.shape and x.tobytes() == y.tobytes() for x, y in pairs)


def angles_rad(a: Splats, b: Splats) -> Doubles:
    """(N,) angle of the rotation between the orientations of `a` and those of `b`."""
    p, q = (s.quats.astype(np.float64) for s in (a, b))
    p /= np.linalg.norm(p, axis=1, keepdims=True)
    q /= np.linalg.norm(q, axis=1, keepdims=True)
    # Computed from the chord, which is accurate near zero, unlike arccos.
    chord = np.minimum(np.linalg.norm(p - q, axis=1), np.linalg.norm(p + q, axis=1))
    angles: Doubles = 4 * np.arcsin(np.minimum(chord / 2, 1))
    return angles


turns_rad = st.floats(-math.pi, math.pi)

places = st.tuples(*[st.floats(-100, 100)] * 3).map(lambda v: np.array(v, np.float64))
"""(3,) metres."""


def unit(vector: tuple[float, ...]) -> Doubles:
    values = np.array(vector, np.float64)
    return np.asarray(values / np.linalg.norm(values), np.float64)


directions = (
    st.tuples(*[st.floats(-1, 1)] * 3).filter(lambda v: float(np.linalg.norm(v)) > 0.1).map(unit)
)
"""(3,) unit vectors."""

rotations = st.builds(rotation_about, directions, turns_rad)


@st.composite
def posed_cameras(draw: st.DrawFn) -> Camera:
    """Cameras anywhere, with pictures of any shape, pixels that are not square, and a principal
    point off the middle."""
    width_px, height_px = draw(st.integers(1, 4000)), draw(st.integers(1, 4000))
    return Camera(
        name="drawn",
        width_px=width_px,
        height_px=height_px,
        fx_px=width_px * draw(st.floats(0.2, 5)),
        fy_px=height_px * draw(st.floats(0.2, 5)),
        cx_px=width_px * draw(st.floats(-0.5, 1.5)),
        cy_px=height_px * draw(st.floats(-0.5, 1.5)),
        w2c=world_to_camera(draw(rotations), draw(places)),
    )
