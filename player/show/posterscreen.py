"""The window before the stream's first picture: its poster, as large as fits."""

from __future__ import annotations

import io
import logging
import time
from collections.abc import Callable

import glfw
import numpy as np
from PIL import Image

from player.render.gl.offscreen import Colour

from .glwindow import GlWindow
from .overlay import Placed
from .overlaygl import OverlayPainter

log = logging.getLogger(__name__)

MAX_SIDE_PX = 4096
"""Largest poster that is decoded: what comes from strangers takes 64 MB at most."""

POLL_S = 0.005
"""Seconds between two looks at the window while others work."""


def read_picture(content: bytes | None) -> Image.Image | None:
    """The picture in a poster's file, RGBA; None where there is none that can be shown, which is
    logged."""
    if content is None:
        return None
    try:
        with Image.open(io.BytesIO(content), formats=("JPEG", "PNG", "WEBP")) as picture:
            if max(picture.size) > MAX_SIDE_PX:
                raise ValueError(f"it has {picture.width}x{picture.height} pixels")
            return picture.convert("RGBA")
    except Exception as error:  # whatever Pillow makes of a stranger's bytes
        log.info("cannot show the poster: %s", error)
        return None


class PosterScreen:
    """Draws only what has changed."""

    def __init__(self, window: GlWindow, picture: Image.Image | None, background: Colour) -> None:
        self._window, self._picture, self._background = window, picture, background
        self._painter = OverlayPainter(window.context)
        self._drawn_px: tuple[int, int] | None = None

    def show_until(self, is_done: Callable[[], bool]) -> bool:
        """Keeps the window alive; False where somebody closed it before that."""
        while not is_done():
            if self._window.is_closed:
                return False
            glfw.poll_events()
            self.draw()
            time.sleep(POLL_S)
        return True

    def draw(self) -> None:
        """The poster in the middle of the window, if its size is another one by now. Without a
        poster, nothing."""
        size_px = self._window.size_px
        if self._picture is None or size_px == self._drawn_px or not all(size_px):
            return
        self._drawn_px = size_px
        screen = self._window.context.screen
        screen.viewport = (0, 0, *size_px)
        screen.use()
        screen.clear(*self._background)
        self._painter.paint(_fitted(self._picture, size_px), screen, size_px)
        self._window.swap()


def _fitted(picture: Image.Image, size_px: tuple[int, int]) -> Placed:
    scale = min(size_px[0] / picture.width, size_px[1] / picture.height)
    width_px, height_px = (max(1, round(side * scale)) for side in picture.size)
    pixels = np.asarray(picture.resize((width_px, height_px), Image.Resampling.BILINEAR))
    corner_px = ((size_px[0] - width_px) // 2, (size_px[1] - height_px) // 2)
    return Placed("poster", pixels, corner_px, 0)
