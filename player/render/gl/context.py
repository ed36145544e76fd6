"""OpenGL for whoever draws: a context of the version asked for, shader programs, an offscreen
picture, and calls that let other threads run.

A shader's text gets the recipe's constants in front; the camera is in its uniforms.
"""

from __future__ import annotations

import ctypes
import math
import sys
from collections.abc import Callable, Mapping
from dataclasses import replace
from enum import Enum
from importlib.resources import files
from typing import Any, TypeVar

import moderngl
import numpy as np
import numpy.typing as npt

from codec.arrays import Floats
from codec.camera import Camera
from codec.errors import SwingsError
from player.render import project
from player.render.cpu import LEAST_COVERAGE
from player.render.project import jacobian_limits
from player.render.renderer import GlVersion
from player.render.upload import COLOUR_COLUMNS

Constants = Mapping[str, int | float | str]

_RECIPE: Constants = {
    "SH_C1": project.SH_C1,
    **{f"SH_C2_{n}": value for n, value in enumerate(project.SH_C2)},
    **{f"SH_C3_{n}": value for n, value in enumerate(project.SH_C3)},
    "COLOUR_COLUMNS": COLOUR_COLUMNS,
    "LOW_PASS_PX2": project.LOW_PASS_PX2,
    "MAX_EXTENT_SIGMA": project.MAX_EXTENT_SIGMA,
    "ALPHA_MIN": project.ALPHA_MIN,
    "ALPHA_MAX": project.ALPHA_MAX,
}


def _head(version: int, constants: Constants) -> str:
    lines = [f"#define {name} {value}" for name, value in {**_RECIPE, **constants}.items()]
    return "\n".join([f"#version {version} core", *lines])


def _text(shader: str) -> str:
    return (files("player.render.gl") / "shaders" / shader).read_text(encoding="utf-8")


def compile_program(
    context: moderngl.Context, shader: str, constants: Constants | None = None, version: int = 330
) -> moderngl.Program:
    """The program of a file that holds both stages."""
    head, source = _head(version, constants or {}), _text(shader)
    return context.program(
        vertex_shader=f"{head}\n#define VERTEX_STAGE\n{source}",
        fragment_shader=f"{head}\n#define FRAGMENT_STAGE\n{source}",
    )


def compile_compute(
    context: moderngl.Context, shader: str, constants: Constants
) -> moderngl.ComputeShader:
    """The compute shader of a file; its `sync()` waits until all of a group see what each wrote."""
    sync = "void sync() { memoryBarrierShared(); barrier(); }"
    return context.compute_shader(f"{_head(430, constants)}\n{sync}\n{_text(shader)}")


class Quads:
    """One quad for each Gaussian that is to be drawn, in its colours or with its depth."""

    def __init__(
        self, context: moderngl.Context, constants: Constants, version: int, slots: moderngl.Buffer
    ) -> None:
        """slots: uint32, which Gaussians, farthest first."""
        self._context, self._constants, self._version = context, constants, version
        self._slots = slots
        self._colours = self._compiled({})
        self._depths: moderngl.VertexArray | None = None  # few ever ask

    def _compiled(self, more: Constants) -> moderngl.VertexArray:
        constants = {**self._constants, **more}
        program = compile_program(self._context, "splat.glsl", constants, self._version)
        if "colours" in program:  # harmonics of degree 2 and 3; depths do not look at them
            program["colours"] = 1
        return self._context.vertex_array(program, [(self._slots, "1u/i", "slot")])

    def seen(self, camera: Camera, depths: bool) -> moderngl.VertexArray:
        """The quads as `camera` sees them; what they blend is their depth, metres, or colours."""
        if depths and self._depths is None:
            self._depths = self._compiled({"DEPTH": 1})
        quads = self._depths if depths and self._depths is not None else self._colours
        set_camera(quads.program, camera)
        return quads


def set_camera(program: moderngl.Program | moderngl.ComputeShader, camera: Camera) -> None:
    """Fills those of the camera's uniforms that the program has."""
    values: dict[str, npt.ArrayLike] = {
        "rotation": camera.w2c[:3, :3].T,  # OpenGL stores columns
        "translation": camera.w2c[:3, 3],
        "position": camera.position,
        "focal_px": (camera.fx_px, camera.fy_px),
        "centre_px": (camera.cx_px, camera.cy_px),
        "limit": jacobian_limits(camera),
        "size_px": (camera.width_px, camera.height_px),
    }
    for name, value in values.items():
        uniform = program.get(name, None)
        # A compiler leaves out what it finds unused: `position` but for linear harmonics.
        if isinstance(uniform, moderngl.Uniform):
            uniform.write(np.ascontiguousarray(value, np.float32))


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
