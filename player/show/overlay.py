"""The overlay of the picture, lines of text and the seek bar, and what draws it onto a window by
OpenGL.

Rule: an overlay is an array of pixels, (H, W, 4) uint8, RGBA, row 0 on top, straight alpha.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cache
from importlib.util import find_spec
from pathlib import Path

import moderngl
import numpy as np
import numpy.typing as npt
from PIL import Image, ImageDraw, ImageFont

from player.playout.conductor import PlayState

Pixels = npt.NDArray[np.uint8]

TEXT_PX = 14
LINE_PX = 18
MARGIN_PX = 8
BAR_PX = 30
"""Height of the strip that the bar lies in: what the mouse may hit."""

CAPTIONS_IN_HEIGHT = 28
"""Letters of captions are this part of the picture's height."""

CAPTION_SHARE = 0.86
"""Most of the picture's width that captions take, as in the browser."""

TRACK_PX = 6
KNOB_PX = 7

_BACK = (0, 0, 0, 150)
_TEXT = (255, 255, 255, 255)
_TRACK = (255, 255, 255, 70)
_BUFFERED = (255, 255, 255, 150)
_PLAYED = (80, 170, 255, 255)


@dataclass(frozen=True)
class Placed:
    """An overlay and its place. Equal only to itself."""

    place: str
    pixels: Pixels = field(compare=False)
    corner_px: tuple[int, int]
    """Left and top."""
    version: int
    """Goes up with every change of what is shown."""


@cache
def _font(size_px: int = TEXT_PX) -> ImageFont.FreeTypeFont | ImageFont.ImageFont:
    return ImageFont.load_default(size_px)


@cache
def _caption_font(size_px: int) -> ImageFont.FreeTypeFont:
    """The font that matplotlib brings: Pillow's own has hardly more than ASCII."""
    found = find_spec("matplotlib")
    assert found is not None
    assert found.origin is not None
    fonts = Path(found.origin).parent / "mpl-data" / "fonts" / "ttf"
    return ImageFont.truetype(str(fonts / "DejaVuSans.ttf"), size_px)


def text_panel(lines: Sequence[str]) -> Pixels:
    """The lines, white on a dark panel that is just large enough; what stands behind a tab is a
    second column."""
    font = _font()
    rows = [line.split("\t", 1) for line in lines]
    columns = [
        max((int(font.getlength(row[n])) for row in rows if len(row) > n), default=0)
        for n in range(2)
    ]
    second_px = MARGIN_PX + columns[0] + 2 * MARGIN_PX
    width_px = second_px + columns[1] if columns[1] else MARGIN_PX + columns[0]
    image = Image.new("RGBA", (width_px + MARGIN_PX, len(rows) * LINE_PX + 2 * MARGIN_PX), _BACK)
    draw = ImageDraw.Draw(image)
    for n, row in enumerate(rows):
        for left_px, text in zip((MARGIN_PX, second_px), row, strict=False):
            draw.text((left_px, MARGIN_PX + n * LINE_PX), text, font=font, fill=_TEXT)
    return np.array(image)


def caption_panel(lines: Sequence[str], size: tuple[int, int]) -> Pixels:
    """The lines, each centred, on a dark panel that a picture of `size` holds; what is too long for
    CAPTION_SHARE of its width goes on in another line, and what is too high is left out."""
    text_px = max(TEXT_PX, size[1] // CAPTIONS_IN_HEIGHT)
    font, most_px = _caption_font(text_px), max(1, int(size[0] * CAPTION_SHARE))
    line_px, margin_px = text_px * LINE_PX // TEXT_PX, text_px * MARGIN_PX // TEXT_PX
    rows = [row for line in lines for row in _wrapped(line, font, most_px)]
    rows = rows[: max(1, (size[1] - margin_px) // line_px)]
    widths_px = [int(font.getlength(row)) for row in rows]
    width_px = min(max(widths_px, default=0) + 2 * margin_px, size[0])
    image = Image.new("RGBA", (width_px, len(rows) * line_px + margin_px), _BACK)
    draw = ImageDraw.Draw(image)
    for n, (row, row_px) in enumerate(zip(rows, widths_px, strict=True)):
        at_px = ((width_px - row_px) // 2, margin_px // 2 + n * line_px)
        draw.text(at_px, row, font=font, fill=_TEXT)
    return np.array(image)


def _wrapped(line: str, font: ImageFont.FreeTypeFont, most_px: int) -> list[str]:
    """The words of `line` in rows of `most_px`; a longer word is cut."""
    rows: list[str] = []
    for word in line.split():
        longer = f"{rows[-1]} {word}" if rows else word
        if rows and font.getlength(longer) <= most_px:
            rows[-1] = longer
            continue
        rows.append("")
        for letter in word:
            if rows[-1] and font.getlength(rows[-1] + letter) > most_px:
                rows.append("")
            rows[-1] += letter
    return rows


def _track(width_px: int) -> tuple[int, int]:
    """Where the bar's track begins and ends."""
    margin_px = min(MARGIN_PX + KNOB_PX, width_px // 4)
    return margin_px, max(margin_px + 1, width_px - margin_px)


def frame_at(x_px: float, width_px: int, state: PlayState) -> int:
    """The frame that the bar of that width shows at `x_px`."""
    left_px, right_px = _track(width_px)
    share = min(max((x_px - left_px) / (right_px - left_px), 0.0), 1.0)
    return state.first_frame + round(share * (state.end_frame - 1 - state.first_frame))


def seek_bar(width_px: int, state: PlayState) -> Pixels:
    """A strip of BAR_PX: all frames, those that can show now, those that were, and a knob."""
    image = Image.new("RGBA", (width_px, BAR_PX), _BACK)
    draw = ImageDraw.Draw(image)
    left_px, right_px = _track(width_px)
    most = max(1, state.end_frame - 1 - state.first_frame)

    def at_px(frame: int) -> float:
        share = (frame - state.first_frame) / most
        return left_px + min(max(share, 0.0), 1.0) * (right_px - left_px)

    top_px, bottom_px = (BAR_PX - TRACK_PX) // 2, (BAR_PX + TRACK_PX) // 2 - 1
    shown_px = at_px(state.frame)
    draw.rectangle((left_px, top_px, right_px, bottom_px), fill=_TRACK)
    if state.buffered_until > state.frame:
        end_px = at_px(state.buffered_until - 1)
        draw.rectangle((shown_px, top_px, end_px, bottom_px), fill=_BUFFERED)
    draw.rectangle((left_px, top_px, shown_px, bottom_px), fill=_PLAYED)
    middle_px = BAR_PX / 2
    draw.ellipse(
        (shown_px - KNOB_PX, middle_px - KNOB_PX, shown_px + KNOB_PX, middle_px + KNOB_PX),
        fill=_TEXT,
    )
    return np.array(image)


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
