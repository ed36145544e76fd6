"""The picture that is drawn into, and how it gets out."""

from __future__ import annotations

import math
from dataclasses import replace
from enum import Enum

import moderngl
import numpy as np

from codec.arrays import Floats
from codec.camera import Camera

from ..depth import LEAST_COVERAGE
from .glcontext import GlError
from .programs import compile_program

Colour = tuple[float, float, float]
"""Red, green and blue, 0..1."""

BLACK: Colour = (0.0, 0.0, 0.0)


class Target(Enum):
    """Format in which pixels are blended; the value is moderngl's name."""

    FLOAT32 = "f4"
    """As the CPU renderer does: for measurements and captures."""
    FLOAT16 = "f2"
    """Finer than any screen at half the memory traffic: for windows."""
    BYTE = "f1"
    """8 bits a channel: the fastest, but every layer that is blended is rounded and clipped."""


class Offscreen:
    """One picture of the size that was asked for last; row 0 of the target is its top."""

    def __init__(self, context: moderngl.Context, target: Target) -> None:
        self._context, self._target = context, target
        self._framebuffer: moderngl.Framebuffer | None = None
        info = context.info
        self.limit_px = min(info["GL_MAX_TEXTURE_SIZE"], *info["GL_MAX_VIEWPORT_DIMS"])
        """Widest and highest picture."""
        self._program = compile_program(context, "screen.glsl")
        self._copy = context.vertex_array(self._program, [])

    def clear(self, camera: Camera) -> None:
        """Makes the target black, of the camera's size, and what is drawn into from now on.

        One of another size is dropped, and freed by the next draw. Raises GlError.
        """
        size = (camera.width_px, camera.height_px)
        if self._framebuffer is None or self._framebuffer.size != size:
            if max(size) > self.limit_px:
                raise GlError(
                    f"this OpenGL draws pictures up to {self.limit_px} pixels wide and high, "
                    f"not {size[0]}x{size[1]}"
                )
            self._picture = self._context.texture(size, 4, dtype=self._target.value)
            self._framebuffer = self._context.framebuffer([self._picture])
        self._framebuffer.use()
        self._framebuffer.clear()

    def read(self, channels: int = 3) -> Floats:
        """(H, W, channels) float32 picture, row 0 on top; the fourth channel is alpha."""
        assert self._framebuffer is not None
        width_px, height_px = self._framebuffer.size
        shape = (height_px, width_px, channels)
        if self._target is not Target.BYTE:
            picture = np.empty(shape, np.float32)
            self._framebuffer.read_into(picture, components=channels, dtype="f4")
            return picture
        bytes_read = np.empty(shape, np.uint8)
        self._framebuffer.read_into(bytes_read, components=channels, dtype="f1", alignment=1)
        return bytes_read.astype(np.float32) / np.float32(255)

    def show(self, screen: moderngl.Framebuffer, background: Colour) -> None:
        """Copies the picture onto the lower left of a window; where nothing covers it the
        background shows."""
        # A window's framebuffer keeps the size that the window was opened with.
        screen.viewport = (0, 0, *self._picture.size)
        screen.use()
        self._context.enable_only(moderngl.NOTHING)
        self._picture.use(0)
        self._program["background"], self._program["corner_px"] = background, (0, 0)
        self._copy.render(moderngl.TRIANGLES, vertices=3)


class DepthPixel:
    """A target of one pixel, for the depth of what it shows."""

    def __init__(self, context: moderngl.Context) -> None:
        pixel = context.texture((1, 1), 4, dtype=Target.FLOAT32.value)
        self._framebuffer = context.framebuffer([pixel])

    def use(self, camera: Camera, x_px: float, y_px: float) -> Camera:
        """Clears the pixel, draws into it from now on, and gives `camera` moved so that what the
        picture has at that place falls on it."""
        self._framebuffer.viewport = (0, 0, camera.width_px, camera.height_px)
        self._framebuffer.use()
        self._framebuffer.clear()
        left_px, top_px = math.floor(x_px), math.floor(y_px)
        return replace(camera, cx_px=camera.cx_px - left_px, cy_px=camera.cy_px - top_px)

    def depth_m(self) -> float | None:
        """The mean depth, weighted as colours are; None if hardly anything shows."""
        pixel = np.frombuffer(self._framebuffer.read(components=4, dtype="f4"), np.float32)
        return float(pixel[0] / pixel[3]) if pixel[3] > LEAST_COVERAGE else None
