"""The interactive window: first the poster, as large as fits, then the pictures, the overlays over
them, and how well it keeps up. controls.py says what its keys and the mouse do.
"""

from __future__ import annotations

import io
import logging
import time
from collections import deque
from collections.abc import Callable
from contextlib import closing
from functools import partial
from typing import TYPE_CHECKING

import glfw
import numpy as np
from PIL import Image

from codec.arrays import Doubles
from codec.camera import Camera
from player.playout.conductor import Conductor, PlayState
from player.playout.timeline import FrameRecord
from player.render.cpu import StepTimes
from player.render.gl import GlRenderer, Target
from player.render.gl.context import BLACK, Colour
from player.render.renderer import Renderer, check_drawable
from player.view.mouse import view_of
from player.view.path import CameraPath

from .captionchoice import CaptionChoice
from .controls import HELP, Controls
from .glwindow import GlWindow
from .overlay import (
    BAR_PX,
    MARGIN_PX,
    OverlayPainter,
    Pixels,
    Placed,
    caption_panel,
    seek_bar,
    text_panel,
)

if TYPE_CHECKING:
    from player.sound.soundplayer import SoundPlayer

WINDOW_S = 1.0
"""Seconds that the figures are of."""


class PlayMeter:
    """Frames drawn and missed in the last second, and what each took."""

    def __init__(self) -> None:
        self._frames: deque[tuple[float, bool]] = deque()  # when, and whether drawn
        self._took_ms: dict[str, float] = {}  # smoothed
        self._last: FrameRecord | None = None
        self.stalls = 0
        self.concealed = 0

    def shown(self, record: FrameRecord, drawn: bool, now_s: float) -> None:
        """A frame was drawn, or passed over. now_s: of the world's time."""
        self._frames.append((now_s, drawn))
        self._last = record
        self.stalls += record.late
        self.concealed += record.concealed
        self._smooth("decode", 1e3 * record.decode_s)

    def took(self, times: StepTimes) -> None:
        """Times of the steps of a picture."""
        if times.upload_ms:
            self._smooth("upload", times.upload_ms)
        self._smooth("sort", times.sort_ms)
        self._smooth("draw", times.draw_ms)

    def _smooth(self, what: str, ms: float) -> None:
        before_ms = self._took_ms.get(what, ms)
        self._took_ms[what] = before_ms + 0.1 * (ms - before_ms)

    def lines(
        self, state: PlayState, num_layers: int, fps: float, rate_bps: float | None, now_s: float
    ) -> list[str]:
        """Lines of the overlay. rate_bps: the estimated rate of the link, if it is known."""
        while self._frames and self._frames[0][0] < now_s - WINDOW_S:
            self._frames.popleft()
        drawn = sum(one for _, one in self._frames)
        layers = self._last.layers if self._last is not None else 0.0
        buffer_s = max(0, state.buffered_until - 1 - state.frame) / fps
        link = "" if rate_bps is None else f", link {rate_bps / 1e6:.1f} Mbit/s"
        moves = "playing" if state.running else "paused"
        if state.seeking:
            moves = "seeking"
        loop = ", looping" if state.loops else ""
        took = ", ".join(f"{what} {ms:.1f}" for what, ms in self._took_ms.items())
        return [
            f"frame {state.frame} of {state.end_frame}, {state.frame / fps:.2f} s, {moves}"
            f" x{state.rate:g}{loop}",
            f"{layers:.2f} of {num_layers} layers, buffer {buffer_s:.1f} s{link}",
            f"{drawn} frames drawn and {len(self._frames) - drawn} missed in the last second, "
            f"{self.stalls} stalls, {self.concealed} concealed",
            f"ms: {took}",
        ]


Make = Callable[[], tuple[Pixels, tuple[int, int]]]

INFO_EVERY_S = 0.25
"""Seconds between two updates of the figures: faster, they cannot be read."""


class Overlays:
    """The info at the top, the help below it, the bar at the bottom, captions above that."""

    def __init__(self, meter: PlayMeter, fps: float, captions: CaptionChoice) -> None:
        self._meter, self._fps, self._captions = meter, fps, captions
        self._held: dict[str, tuple[object, Placed]] = {}
        self._info_s = -INFO_EVERY_S

    def now(
        self,
        conductor: Conductor,
        controls: Controls,
        size: tuple[int, int],
        now_s: float,
        pointed: Callable[[], Doubles | None],
    ) -> list[Placed]:
        """Overlays of a picture of `size`. pointed: finds the point, (3,) metres, world, that the
        pointer is on, which takes a moment."""
        state = conductor.state()
        shown, top_px = [], MARGIN_PX
        if controls.shows_info:
            if now_s - self._info_s >= INFO_EVERY_S or "info" not in self._held:
                self._info_s = now_s
                info = self._text("info", self._lines(conductor, state, now_s, pointed()), top_px)
            else:
                info = self._held["info"][1]
            shown.append(info)
            top_px += info.pixels.shape[0] + MARGIN_PX
        if controls.shows_help:
            shown.append(self._text("help", HELP, top_px))
        if controls.shows_bar and size[1] > BAR_PX:
            shown.append(self._bar(state, size))
        if (lines := self._captions.lines(state.frame / self._fps)) and all(size):
            shown.append(self._caption(lines, size))
        return shown

    def _caption(self, lines: tuple[str, ...], size: tuple[int, int]) -> Placed:
        def make() -> tuple[Pixels, tuple[int, int]]:
            pixels = caption_panel(lines, size)
            height_px, width_px, _ = pixels.shape
            top_px = max(0, size[1] - BAR_PX - MARGIN_PX - height_px)
            return pixels, ((size[0] - width_px) // 2, top_px)

        return self._keep("captions", (lines, size), make)

    def _lines(
        self, conductor: Conductor, state: PlayState, now_s: float, point: Doubles | None
    ) -> tuple[str, ...]:
        source = conductor.source
        lines = self._meter.lines(
            state, source.manifest.num_layers, self._fps, source.play.rate_bps, now_s
        )
        at = "-" if point is None else " ".join(f"{metres:.3f}" for metres in point)
        return (*lines, f"pointer on {at}")

    def _text(self, place: str, lines: tuple[str, ...], top_px: int) -> Placed:
        key = (lines, top_px)
        return self._keep(place, key, lambda: (text_panel(lines), (MARGIN_PX, top_px)))

    def _bar(self, state: PlayState, size: tuple[int, int]) -> Placed:
        width_px, height_px = size
        key = (state, size)
        corner_px = (0, height_px - BAR_PX)
        return self._keep("bar", key, lambda: (seek_bar(width_px, state), corner_px))

    def _keep(self, place: str, key: object, make: Make) -> Placed:
        held = self._held.get(place)
        if held is not None and held[0] == key:
            return held[1]
        pixels, corner_px = make()
        version = held[1].version + 1 if held is not None else 0
        placed = Placed(place, pixels, corner_px, version)
        self._held[place] = (key, placed)
        return placed


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


IDLE_S = 0.005
"""Seconds between two looks at the keyboard while there is nothing new to draw."""


Note = Callable[[FrameRecord, bool], None]
"""Called with each frame, and whether it was drawn: it is not if a newer one was due by then."""


def show_window(
    window: GlWindow,
    poster: PosterScreen,
    conductor: Conductor,
    path: CameraPath,
    renderers: list[Renderer],
    note: Note,
    background: Colour = BLACK,
    *,
    captions: CaptionChoice,
    sound: SoundPlayer | None = None,
) -> None:
    """Shows what plays until the window is closed: first the poster, at last the last picture.

    renderers: gets the one that draws, for its name and counters. sound: is heard from the camera.
    """
    manifest = conductor.source.manifest
    check_drawable(manifest)
    renderer = GlRenderer(manifest, Target.FLOAT16, window.context, window.version)
    renderers.append(renderer)
    with closing(renderer):
        conductor.smoothing.pictures_hz = window.pictures_hz
        conductor.attach(renderer)
        _Shown(window, poster, conductor, path, background, captions, sound).show(renderer, note)


class _Shown:
    """A play in a window, and the camera that a person moves."""

    def __init__(
        self,
        window: GlWindow,
        poster: PosterScreen,
        conductor: Conductor,
        path: CameraPath,
        background: Colour,
        captions: CaptionChoice,
        sound: SoundPlayer | None,
    ) -> None:
        source = conductor.source
        self._sound = sound
        self._window, self._poster = window, poster
        self._conductor, self._path, self._background = conductor, path, background
        self._view = view_of(source.manifest)
        self._controls = Controls(
            window.handle, conductor, self._view, path(source.frames.first).fy_px, captions, sound
        )
        self._painter = OverlayPainter(window.context)
        self._meter = PlayMeter()
        self._overlays = Overlays(self._meter, source.manifest.fps, captions)

    def show(self, renderer: GlRenderer, note: Note) -> None:
        """Returns when the window is closed."""
        frame, drawn, camera, glides = None, None, None, 0
        waiting: list[FrameRecord] = []
        last_s = time.monotonic()
        while not self._window.is_closed:
            glfw.poll_events()
            now_s = time.monotonic()
            # Only while the figures show does each step wait for the GPU.
            renderer.times = renderer.times or StepTimes() if self._controls.shows_info else None
            for record in self._conductor.poll():
                waiting.append(record)
                frame = record.frame
            glides += renderer.glide(self._conductor.share)
            if camera is not None:
                self._controls.fly(camera, now_s - last_s)
            last_s = now_s
            size = self._window.size_px
            pointed = partial(self._pointed, renderer, camera)
            overlays = self._overlays.now(self._conductor, self._controls, size, now_s, pointed)
            state = (frame, glides, self._controls.changes, size, overlays)
            if frame is None:
                self._poster.draw()
            if frame is None or state == drawn or not all(size):
                self._noted(waiting, None, note)  # a window without a size shows nothing
                time.sleep(IDLE_S)
                continue
            camera = self._view.applied(self._path(frame)).fitted(*size)
            renderer.present(frame, camera, self._window.context.screen, self._background)
            for placed in overlays:
                self._painter.paint(placed, self._window.context.screen, size)
            if renderer.times is not None:
                self._meter.took(renderer.times)
            self._window.swap()
            if self._sound is not None:
                self._sound.camera = camera
            drawn = state
            self._noted(waiting, frame, note)

    def _pointed(self, renderer: GlRenderer, camera: Camera | None) -> Doubles | None:
        """(3,) metres, world: what the pointer is on in the last picture, which `camera` saw."""
        if camera is None:
            return None
        at_px = self._controls.pointer_px((camera.width_px, camera.height_px))
        depth_m = renderer.depth_at(camera, *at_px) if at_px is not None else None
        if at_px is None or depth_m is None:
            return None
        return camera.unproject(*np.array([*at_px, depth_m], np.float64))

    def _noted(self, waiting: list[FrameRecord], frame: int | None, note: Note) -> None:
        """`frame` was drawn, of those that waited to be."""
        for record in waiting:
            note(record, record.frame == frame)
            self._meter.shown(record, record.frame == frame, time.monotonic())
        waiting.clear()
