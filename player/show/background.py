"""The background, where the Gaussians let light through."""

from __future__ import annotations

import numpy as np

from codec.arrays import Floats
from player.render.gl.context import BLACK, Colour

__all__ = ["BLACK", "TRANSPARENT", "Colour", "on_background"]

TRANSPARENT = None
"""In place of a colour: the picture keeps its alpha."""


def on_background(picture: Floats, background: Colour | None) -> Floats:
    """A drawn picture (H, W, 4), premultiplied, before a background: (H, W, 3); for TRANSPARENT
    (H, W, 4) with straight alpha, as PNG wants it."""
    colours, alpha = picture[..., :3], picture[..., 3:]
    if background is not None:
        return colours + (1 - alpha) * np.array(background, np.float32)
    # Where nothing is, any colour is as good; what is brighter than its alpha allows is clipped.
    straight = np.divide(colours, alpha, out=np.zeros_like(colours), where=alpha > 0)
    return np.concatenate([straight, alpha], axis=-1)
