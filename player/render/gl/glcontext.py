"""OpenGL contexts: which version is asked for, and calls that let other threads run."""

from __future__ import annotations

import ctypes
import sys
from collections.abc import Callable
from typing import Any, TypeVar

import moderngl

from codec.errors import SwingsError

from ..renderer import GlVersion

Opened = TypeVar("Opened")

SOFTWARE = ("llvmpipe", "softpipe", "SwiftShader", "Software Rasterizer")
"""Parts of the names of renderers without a GPU."""

_COMMAND_BUFFER = 0x8F3F  # GL_DRAW_INDIRECT_BUFFER


class GlError(SwingsError):
    """OpenGL cannot start, or cannot hold the stream."""


def first_context(version: GlVersion, opening: Callable[[GlVersion], Opened]) -> Opened:
    """The result of `opening` for `version`; for AUTO with 4.3, or, where that fails, with 3.3.

    A driver may give exactly what it is asked for, so the newer version is asked for first.
    Raises GlError; `opening` raises any exception, as moderngl does.
    """
    versions = (GlVersion.V43, GlVersion.V33) if version is GlVersion.AUTO else (version,)
    for asked in versions:
        try:
            return opening(asked)
        except Exception as error:  # moderngl and glcontext raise bare Exception
            if asked is versions[-1]:
                if isinstance(error, SwingsError):
                    raise
                reason = " ".join(str(error).split()) or type(error).__name__
                raise GlError(f"OpenGL {asked} cannot start: {reason}") from error
    raise AssertionError("there is a last version")


def open_context(version: GlVersion = GlVersion.AUTO) -> moderngl.Context:
    """A context of its own, without a window or a display, current in this thread."""
    # Elsewhere than on Linux the default back end needs no display.
    backend: dict[str, Any] = {"backend": "egl"} if sys.platform.startswith("linux") else {}

    def opening(asked: GlVersion) -> moderngl.Context:
        return moderngl.create_context(require=asked.code, standalone=True, **backend)

    return first_context(version, opening)


def version_for(context: moderngl.Context, version: GlVersion) -> GlVersion:
    """Which of the two ways of drawing this context gets. Raises GlError if it lacks `version`.

    AUTO takes 4.3 on a GPU only: on llvmpipe the pictures take about the same time, but compute
    shaders order 200,000 Gaussians in 80 ms, the CPU's own code in 2.
    """
    if version is GlVersion.AUTO:
        name = context.info["GL_RENDERER"]
        software = any(word in name for word in SOFTWARE)
        return GlVersion.V33 if software or context.version_code < 430 else GlVersion.V43
    if context.version_code < version.code:
        found = context.info["GL_VERSION"]
        raise GlError(f"OpenGL {version} was requested, but this driver has {found}")
    return version


class Unlocked:
    """The calls that take long, made so that other threads run meanwhile.

    moderngl keeps the interpreter's lock during a call, ctypes does not. A software renderer works
    inside them: with the lock it would starve the update thread for most of a frame.
    """

    def __init__(self, context: moderngl.Context) -> None:
        macos = "/System/Library/Frameworks/OpenGL.framework/OpenGL"
        self._context = context
        self._library: ctypes.CDLL | None = None
        uint, sint = ctypes.c_uint, ctypes.c_int
        types: dict[str, tuple[Any, ...]] = {"glDrawArraysInstanced": (uint, sint, sint, sint)}
        types["glDrawArrays"] = (uint, sint, sint)
        types["glFinish"] = ()
        if context.version_code >= 430:
            types["glBindBuffer"] = (uint, uint)
            types["glDrawArraysIndirect"] = (uint, ctypes.c_void_p)
            types["glDispatchCompute"] = (uint, uint, uint)
        try:
            library = ctypes.CDLL({"linux": "libGL.so.1", "darwin": macos}[sys.platform])
            for name, arguments in types.items():
                function = getattr(library, name)
                function.argtypes, function.restype = arguments, None
        except (KeyError, OSError, AttributeError):
            return  # moderngl's own calls do the same
        self._library = library

    def draw_quads(self, quads: moderngl.VertexArray, count: int) -> None:
        if self._library is None:
            quads.render(moderngl.TRIANGLE_STRIP, vertices=4, instances=count)
            return
        # No instance at all: this only binds the program and its buffers.
        quads.render(moderngl.TRIANGLE_STRIP, vertices=4, instances=0)
        self._library.glDrawArraysInstanced(moderngl.TRIANGLE_STRIP, 0, 4, count)

    def draw_points(self, points: moderngl.VertexArray, first: int, count: int) -> None:
        """Draws the vertices from `first` on, each as a point."""
        if self._library is None:
            points.render(moderngl.POINTS, vertices=count, first=first)
            return
        points.render(moderngl.POINTS, vertices=0)
        self._library.glDrawArrays(moderngl.POINTS, first, count)

    def draw_command(self, quads: moderngl.VertexArray, command: moderngl.Buffer) -> None:
        """Draws as many quads as the command in the GPU's own memory says."""
        if self._library is None:
            quads.render_indirect(command, moderngl.TRIANGLE_STRIP, count=1)
            return
        quads.render(moderngl.TRIANGLE_STRIP, vertices=4, instances=0)
        self._library.glBindBuffer(_COMMAND_BUFFER, command.glo)
        self._library.glDrawArraysIndirect(moderngl.TRIANGLE_STRIP, None)

    def compute(self, shader: moderngl.ComputeShader, groups: int) -> None:
        """Runs `groups` groups of a shader; what runs next sees what they wrote."""
        if self._library is None:
            shader.run(groups)
        else:
            shader.run(0)  # binds it
            self._library.glDispatchCompute(groups, 1, 1)
        self._context.memory_barrier()

    def finish(self) -> None:
        """Waits until everything is drawn."""
        if self._library is None:
            self._context.finish()
        else:
            self._library.glFinish()
