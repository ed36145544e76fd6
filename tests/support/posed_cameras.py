"""Directions, rotations and cameras as hypothesis draws them."""

from __future__ import annotations

import math

import numpy as np
from hypothesis import strategies as st

from codec.camera import Camera
from codec.pose import Doubles, rotation_about, world_to_camera

angles_rad = st.floats(-math.pi, math.pi)

places = st.tuples(*[st.floats(-100, 100)] * 3).map(lambda v: np.array(v, np.float64))
"""(3,) metres."""


def unit(vector: tuple[float, ...]) -> Doubles:
    values = np.array(vector, np.float64)
    return np.asarray(values / np.linalg.norm(values), np.float64)


directions = (
    st.tuples(*[st.floats(-1, 1)] * 3).filter(lambda v: float(np.linalg.norm(v)) > 0.1).map(unit)
)
"""(3,) unit vectors."""

rotations = st.builds(rotation_about, directions, angles_rad)


@st.composite
def posed_cameras(draw: st.DrawFn) -> Camera:
    """Cameras anywhere, of any shape, with pixels that are not square and a middle off the
    middle."""
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
