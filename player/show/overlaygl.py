"""Draws overlays onto a window by OpenGL, over whatever is there."""

from __future__ import annotations

import moderngl
import numpy as np

from .overlay import Pixels, Placed

_VERTEX = """
#version 330 core
uniform vec4 area;  // left, top, width, height in clip space; height points down
out vec2 at;
void main() {
    at = vec2(gl_VertexID & 1, gl_VertexID >> 1);
    gl_Position = vec4(area.xy + at * vec2(area.z, -area.w), 0.0, 1.0);
}
"""

_FRAGMENT = """
#version 330 core
uniform sampler2D pixels;
in vec2 at;
out vec4 colour;
void main() { colour = texture(pixels, at); }
"""


class OverlayPainter:
    """Belongs to the thread of its context. Keeps one texture for each place."""

    def __init__(self, context: moderngl.Context) -> None:
        self._context = context
        self._program = context.program(vertex_shader=_VERTEX, fragment_shader=_FRAGMENT)
        self._quad = context.vertex_array(self._program, [])
        self._textures: dict[str, tuple[Pixels, moderngl.Texture]] = {}

    def paint(
        self,
        placed: Placed,
        screen: moderngl.Framebuffer,
        size_px: tuple[int, int],
    ) -> None:
        """Draws it on a `screen` of that width and height. What has not changed since it was drawn
        last is not uploaded."""
        pixels, (left_px, top_px) = placed.pixels, placed.corner_px
        texture = self._texture(placed.place, pixels)
        width_px, height_px = size_px
        screen.viewport = (0, 0, width_px, height_px)
        screen.use()
        self._context.enable_only(moderngl.BLEND)
        self._context.blend_func = moderngl.SRC_ALPHA, moderngl.ONE_MINUS_SRC_ALPHA
        area = (
            2 * left_px / width_px - 1,
            1 - 2 * top_px / height_px,
            2 * pixels.shape[1] / width_px,
            2 * pixels.shape[0] / height_px,
        )
        uniform = self._program["area"]
        assert isinstance(uniform, moderngl.Uniform)
        uniform.write(np.array(area, np.float32))
        texture.use(0)
        self._quad.render(moderngl.TRIANGLE_STRIP, vertices=4)

    def _texture(self, place: str, pixels: Pixels) -> moderngl.Texture:
        held = self._textures.get(place)
        if held is not None and held[0] is pixels:
            return held[1]
        size = (pixels.shape[1], pixels.shape[0])
        texture = held[1] if held is not None else None
        if texture is None or texture.size != size:
            # What is dropped is freed at the renderer's next frame.
            texture = self._context.texture(size, 4)
            texture.filter = (moderngl.NEAREST, moderngl.NEAREST)
        texture.write(np.ascontiguousarray(pixels))
        self._textures[place] = (pixels, texture)
        return texture
