"""A window with an OpenGL context."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import glfw
import moderngl

from codec.errors import SwingsError
from player.render.gl import first_context
from player.render.renderer import GlVersion
from player.view.path import Size


class WindowError(SwingsError):
    """No window can be opened here."""


@contextmanager
def window_system() -> Iterator[None]:
    """Makes glfw ready to open windows. Raises WindowError where there can be none."""
    glfw.ERROR_REPORTING = "ignore"  # asked for below instead of warned about
    if not glfw.init():
        raise WindowError(f"cannot open a window ({_reason()}); use --capture OUT.mp4")
    try:
        yield
    finally:
        glfw.terminate()


def _reason() -> str:
    text: Any = glfw.get_error()[1]  # bytes or None, whatever its annotation says
    return text.decode(errors="replace") if text else "glfw reports no reason"


class GlWindow:
    """Belongs to the main thread. `window_system` closes it."""

    def __init__(self, size: Size, title: str, version: GlVersion) -> None:
        """Raises WindowError, and GlError where one version of OpenGL is asked for in vain."""

        def opening(asked: GlVersion) -> tuple[Any, moderngl.Context]:
            handle = _open(size, title, asked)
            try:
                return handle, moderngl.create_context(require=asked.code)
            except Exception:
                glfw.destroy_window(handle)
                raise

        self.version = version
        self.handle, self.context = first_context(version, opening)

    @property
    def size_px(self) -> tuple[int, int]:
        """Width and height of the picture in it; 0 while it is hidden."""
        width_px, height_px = glfw.get_framebuffer_size(self.handle)
        return int(width_px), int(height_px)

    @property
    def pictures_hz(self) -> float:
        """Pictures a second that the screen shows; 60 where that is not known."""
        monitor = glfw.get_window_monitor(self.handle) or glfw.get_primary_monitor()
        mode = glfw.get_video_mode(monitor) if monitor else None
        return float(mode.refresh_rate) if mode and mode.refresh_rate > 0 else 60.0

    @property
    def is_closed(self) -> bool:
        return bool(glfw.window_should_close(self.handle))

    def swap(self) -> None:
        """Shows what was drawn."""
        glfw.swap_buffers(self.handle)


def _open(size: Size, title: str, version: GlVersion) -> Any:
    glfw.window_hint(glfw.CONTEXT_VERSION_MAJOR, version.code // 100)
    glfw.window_hint(glfw.CONTEXT_VERSION_MINOR, version.code // 10 % 10)
    glfw.window_hint(glfw.OPENGL_PROFILE, glfw.OPENGL_CORE_PROFILE)
    glfw.window_hint(glfw.OPENGL_FORWARD_COMPAT, True)
    window = glfw.create_window(size.width_px, size.height_px, f"swings: {title}", None, None)
    if not window:
        raise WindowError(f"cannot open a window ({_reason()}); use --capture OUT.mp4")
    glfw.make_context_current(window)
    glfw.swap_interval(1)
    return window
