"""Conversion of cameras to and from the browser's form."""

from __future__ import annotations

import numpy as np

from codec.camera import Camera
from tests.support.web.nodeprocess import Json


def for_browser(camera: Camera) -> dict[str, object]:
    return {
        "name": camera.name,
        "widthPx": camera.width_px,
        "heightPx": camera.height_px,
        "fxPx": camera.fx_px,
        "fyPx": camera.fy_px,
        "cxPx": camera.cx_px,
        "cyPx": camera.cy_px,
        "w2c": camera.w2c.ravel().tolist(),
    }


def from_browser(found: Json) -> Camera:
    size = (found["widthPx"], found["heightPx"])
    lens = (found["fxPx"], found["fyPx"], found["cxPx"], found["cyPx"])
    return Camera("found", *size, *lens, np.array(found["w2c"], np.float64).reshape(4, 4))
