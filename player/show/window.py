"""The interactive window: the mouse moves the camera while the stream plays.

Left button turns around the scene, right button moves it, the wheel comes nearer, space pauses, R
goes back to the path's camera, Escape closes.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import glfw
import moderngl

from codec.errors import SwingsError
from player.playout.queues import Events
from player.playout.threads import Threads
from player.playout.timeline import FrameRecord
from player.render.gl import MIN_VERSION, GlError, GlRenderer, Target
from player.render.renderer import check_drawable
from player.source.source import Source
from player.view.mouse import View, view_of
from player.view.path import CameraPath, Size

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


def show_window(
    path: CameraPath,
    source: Source,
    events: Events,
    keep: Callable[[FrameRecord], None],
) -> GlRenderer:
    """Plays until the window is closed; gives the renderer, closed, for its name and counters."""
    check_drawable(source.manifest)
    first = path(source.frames.first)
    with Threads(source, events) as threads:
        window = _open(Size(first.width_px, first.height_px), source.name)
        try:
            context = moderngl.create_context(require=MIN_VERSION)
        except Exception as error:  # moderngl and glcontext raise bare Exception
            raise GlError(f"OpenGL 3.3 cannot start in a window: {error}") from error
        renderer = GlRenderer(source.manifest, Target.FLOAT16, context)
        view = view_of(source.manifest)
        controls = _Controls(window, view, events, first.fy_px)
        handoff = threads.update(renderer)
        frame, drawn = None, None
        try:
            while not glfw.window_should_close(window):
                glfw.poll_events()
                for record in handoff.poll():
                    keep(record)
                    frame = record.frame
                state = (frame, controls.changes, glfw.get_framebuffer_size(window))
                if frame is None or state == drawn or not all(state[2]):
                    time.sleep(IDLE_S)
                    continue
                camera = view.applied(path(frame)).fitted(*state[2])
                renderer.present(frame, camera, context.screen)
                glfw.swap_buffers(window)
                drawn = state
        finally:
            renderer.close()
    return renderer


def _open(size: Size, title: str) -> Any:
    glfw.window_hint(glfw.CONTEXT_VERSION_MAJOR, 3)
    glfw.window_hint(glfw.CONTEXT_VERSION_MINOR, 3)
    glfw.window_hint(glfw.OPENGL_PROFILE, glfw.OPENGL_CORE_PROFILE)
    glfw.window_hint(glfw.OPENGL_FORWARD_COMPAT, True)
    window = glfw.create_window(size.width_px, size.height_px, f"swings: {title}", None, None)
    if not window:
        raise WindowError(f"no window can be opened here ({_reason()}); use --capture OUT.mp4")
    glfw.make_context_current(window)
    glfw.swap_interval(1)
    return window


class _Controls:
    """Turns mouse and keys into a View. `changes` goes up with whatever changes the picture."""

    def __init__(self, window: Any, view: View, events: Events, focal_px: float) -> None:
        self._view, self._events, self._focal_px = view, events, focal_px
        self._at_px = (0.0, 0.0)
        self.changes = 0
        glfw.set_cursor_pos_callback(window, self._moved)
        glfw.set_scroll_callback(window, self._scrolled)
        glfw.set_key_callback(window, self._pressed)
        glfw.set_window_refresh_callback(window, self._damaged)

    def _moved(self, window: Any, x_px: float, y_px: float) -> None:
        right_px, down_px = x_px - self._at_px[0], y_px - self._at_px[1]
        self._at_px = (x_px, y_px)
        if glfw.get_mouse_button(window, glfw.MOUSE_BUTTON_LEFT) == glfw.PRESS:
            self._view.drag_turn(right_px, down_px)
        elif glfw.get_mouse_button(window, glfw.MOUSE_BUTTON_RIGHT) == glfw.PRESS:
            self._view.drag_pan(right_px, down_px, self._focal_px)
        else:
            return
        self.changes += 1

    def _scrolled(self, window: Any, x_steps: float, y_steps: float) -> None:
        self._view.scroll(y_steps)
        self.changes += 1

    def _pressed(self, window: Any, key: int, code: int, action: int, modifiers: int) -> None:
        if action != glfw.PRESS:
            return
        if key == glfw.KEY_ESCAPE:
            glfw.set_window_should_close(window, True)
        elif key == glfw.KEY_SPACE:
            self._events.toggle_pause()
        elif key == glfw.KEY_R:
            self._view.reset()
            self.changes += 1

    def _damaged(self, window: Any) -> None:
        self.changes += 1
