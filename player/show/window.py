"""The interactive window: the mouse moves the camera while the stream plays.

Left button turns around the scene, right button moves it, the wheel comes nearer, space pauses, R
goes back to the path's camera, Escape closes.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager, closing, contextmanager
from typing import Any

import glfw
import moderngl

from codec.errors import SwingsError
from player.playout.queues import Events, Handoff
from player.playout.threads import Joined, Threads
from player.playout.timeline import FrameRecord
from player.render.gl import GlRenderer, Target, first_context
from player.render.renderer import GlVersion, Renderer, check_drawable
from player.view.mouse import View, view_of
from player.view.path import Size

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


Join = Callable[[], AbstractContextManager[Joined]]
Note = Callable[[FrameRecord, bool], None]
"""Told of each frame, and whether it was drawn: not where a newer one was due by then."""


def show_window(
    joins: Sequence[Join],
    renderers: list[Renderer],
    note: Note,
    version: GlVersion = GlVersion.AUTO,
) -> None:
    """Plays what each of `joins` asks for, one after another, until the window is closed.

    renderers: gets the one of each play, for its name and counters.
    """
    window: _Window | None = None
    for number, join in enumerate(joins):
        with join() as joined, Threads(joined.source, joined.events) as threads:
            manifest = joined.source.manifest
            check_drawable(manifest)
            window = window or _Window(joined, version)
            renderer = GlRenderer(manifest, Target.FLOAT16, window.context, version)
            renderers.append(renderer)
            with closing(renderer):
                # The last picture stays until the window is closed.
                ends = number + 1 < len(joins)
                window.play(joined, renderer, threads.update(renderer), note, ends)
        if window.closed:
            return


class _Window:
    """The window of all plays, and the camera that the mouse moved."""

    def __init__(self, joined: Joined, version: GlVersion) -> None:
        first = joined.path(joined.source.frames.first)
        size = Size(first.width_px, first.height_px)

        def opening(asked: GlVersion) -> tuple[Any, moderngl.Context]:
            window = _open(size, joined.source.name, asked)
            try:
                return window, moderngl.create_context(require=asked.code)
            except Exception:
                glfw.destroy_window(window)
                raise

        self._window, self.context = first_context(version, opening)
        self._view = view_of(joined.source.manifest)
        self._controls = _Controls(self._window, self._view, first.fy_px)

    @property
    def closed(self) -> bool:
        return bool(glfw.window_should_close(self._window))

    def play(
        self, joined: Joined, renderer: GlRenderer, handoff: Handoff, note: Note, ends: bool
    ) -> None:
        """Shows one play; returns when the window is closed, or, if it `ends`, after its last
        frame."""
        self._controls.events = joined.events
        frame, drawn = None, None
        waiting: list[FrameRecord] = []
        while not self.closed:
            glfw.poll_events()
            ended = handoff.ended
            for record in handoff.poll():
                waiting.append(record)
                frame = record.frame
            size = glfw.get_framebuffer_size(self._window)
            state = (frame, self._controls.changes, size)
            if frame is None or state == drawn or not all(size):
                for record in waiting:  # nobody sees a window without a size
                    note(record, False)
                waiting.clear()
                if ends and ended:
                    return
                time.sleep(IDLE_S)
                continue
            camera = self._view.applied(joined.path(frame)).fitted(*size)
            if waiting:
                renderer.upload(frame)
            renderer.present(frame, camera, self.context.screen)
            glfw.swap_buffers(self._window)
            drawn = state
            for record in waiting:
                note(record, record.frame == frame)
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


class _Controls:
    """Turns mouse and keys into a View. `changes` goes up with whatever changes the picture."""

    def __init__(self, window: Any, view: View, focal_px: float) -> None:
        self._view, self._focal_px = view, focal_px
        self.events: Events | None = None
        """What plays now."""
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
            if self.events is not None:
                self.events.toggle_pause()
        elif key == glfw.KEY_R:
            self._view.reset()
            self.changes += 1

    def _damaged(self, window: Any) -> None:
        self.changes += 1
