"""The interactive window; controls.py says what its keys and the mouse do."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager
from typing import Any

import glfw
import moderngl

from codec.camera import Camera
from codec.errors import SwingsError
from player.playout.conductor import Conductor
from player.playout.timeline import FrameRecord
from player.render.gl import GlRenderer, Target, first_context
from player.render.gl.offscreen import BLACK, Colour
from player.render.renderer import GlVersion, Renderer, check_drawable
from player.render.steptimes import StepTimes
from player.view.mouse import view_of
from player.view.path import CameraPath, Size

from .controls import Controls
from .overlaygl import OverlayPainter
from .overlays import Overlays
from .playmeter import PlayMeter

IDLE_S = 0.005
"""Seconds between two looks at the keyboard while there is nothing new to draw."""


class WindowError(SwingsError):
    """No window can be opened here."""


@contextmanager
def window_system() -> Iterator[None]:
    """Makes glfw ready to open windows. Raises WindowError where there can be none."""
    glfw.ERROR_REPORTING = "ignore"  # asked for below instead of warned about
    if not glfw.init():
        raise WindowError(f"no window can be opened here ({_reason()}); use --capture OUT.mp4")
    try:
        yield
    finally:
        glfw.terminate()


def _reason() -> str:
    text: Any = glfw.get_error()[1]  # bytes or None, whatever its annotation says
    return text.decode(errors="replace") if text else "glfw does not say why"


Note = Callable[[FrameRecord, bool], None]
"""Told of each frame, and whether it was drawn: not where a newer one was due by then."""


def show_window(
    conductor: Conductor,
    path: CameraPath,
    renderers: list[Renderer],
    note: Note,
    record_camera: Callable[[int, Camera], object],
    version: GlVersion = GlVersion.AUTO,
    background: Colour = BLACK,
) -> None:
    """Shows what plays until the window is closed. The last picture stays until then.

    renderers: gets the one that draws, for its name and counters. record_camera: is told which one
    showed which frame.
    """
    manifest = conductor.source.manifest
    check_drawable(manifest)
    window = _Window(conductor, path, version, background)
    renderer = GlRenderer(manifest, Target.FLOAT16, window.context, version)
    renderers.append(renderer)
    with closing(renderer):
        conductor.attach(renderer)
        window.show(renderer, note, record_camera)


class _Window:
    """The window, and the camera that a person moves."""

    def __init__(
        self, conductor: Conductor, path: CameraPath, version: GlVersion, background: Colour
    ) -> None:
        source = conductor.source
        first = path(source.frames.first)
        size = Size(first.width_px, first.height_px)
        self._conductor, self._path, self._background = conductor, path, background

        def opening(asked: GlVersion) -> tuple[Any, moderngl.Context]:
            window = _open(size, source.name, asked)
            try:
                return window, moderngl.create_context(require=asked.code)
            except Exception:
                glfw.destroy_window(window)
                raise

        self._window, self.context = first_context(version, opening)
        self._view = view_of(source.manifest)
        self._controls = Controls(self._window, conductor, self._view, first.fy_px)
        self._painter = OverlayPainter(self.context)
        self._meter = PlayMeter()
        self._overlays = Overlays(self._meter, source.manifest.fps)

    def show(
        self, renderer: GlRenderer, note: Note, record_camera: Callable[[int, Camera], object]
    ) -> None:
        """Returns when the window is closed."""
        frame, drawn, camera = None, None, None
        waiting: list[FrameRecord] = []
        last_s = time.monotonic()
        while not glfw.window_should_close(self._window):
            glfw.poll_events()
            now_s = time.monotonic()
            # Only who looks at the figures waits for the GPU after each step.
            renderer.times = renderer.times or StepTimes() if self._controls.shows_info else None
            for record in self._conductor.poll():
                waiting.append(record)
                frame = record.frame
            if camera is not None:
                self._controls.fly(camera, now_s - last_s)
            last_s = now_s
            size = glfw.get_framebuffer_size(self._window)
            overlays = self._overlays.now(self._conductor, self._controls, size, now_s)
            state = (frame, self._controls.changes, size, overlays)
            if frame is None or state == drawn or not all(size):
                self._noted(waiting, None, note)  # nobody sees a window without a size
                time.sleep(IDLE_S)
                continue
            camera = self._view.applied(self._path(frame)).fitted(*size)
            renderer.present(frame, camera, self.context.screen, self._background)
            for placed in overlays:
                self._painter.paint(placed, self.context.screen, size)
            if renderer.times is not None:
                self._meter.took(renderer.times)
            glfw.swap_buffers(self._window)
            record_camera(frame, camera)
            drawn = state
            self._noted(waiting, frame, note)

    def _noted(self, waiting: list[FrameRecord], frame: int | None, note: Note) -> None:
        """`frame` was drawn, of those that waited to be."""
        for record in waiting:
            note(record, record.frame == frame)
            self._meter.shown(record, record.frame == frame, time.monotonic())
        waiting.clear()


def _open(size: Size, title: str, version: GlVersion) -> Any:
    glfw.window_hint(glfw.CONTEXT_VERSION_MAJOR, version.code // 100)
    glfw.window_hint(glfw.CONTEXT_VERSION_MINOR, version.code // 10 % 10)
    glfw.window_hint(glfw.OPENGL_PROFILE, glfw.OPENGL_CORE_PROFILE)
    glfw.window_hint(glfw.OPENGL_FORWARD_COMPAT, True)
    window = glfw.create_window(size.width_px, size.height_px, f"swings: {title}", None, None)
    if not window:
        raise WindowError(f"no window can be opened here ({_reason()}); use --capture OUT.mp4")
    glfw.make_context_current(window)
    glfw.swap_interval(1)
    return window
