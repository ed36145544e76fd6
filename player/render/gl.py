"""OpenGL 3.3: the window stays in one texture, and a frame uploads what its slice changes.

Rule: one thread makes a GlRenderer, draws with it and closes it; only `put` and `forget_waiting`
may come from others, and they make no GL call.
"""

from __future__ import annotations

import ctypes
import logging
import sys
import threading
from contextlib import AbstractContextManager, nullcontext
from enum import Enum
from importlib.resources import files
from typing import Any

import moderngl
import numpy as np
import numpy.typing as npt

from codec.camera import Camera
from codec.errors import SwingsError
from codec.slice import Slice
from codec.stream.manifest import Manifest

from . import recipe
from .arrivals import Arrivals
from .lane import check_slice
from .order import Order
from .pack import TEXTURE_WIDTH_PX
from .patch import PackedLanes, PackedSlice
from .project import jacobian_limits

log = logging.getLogger(__name__)

Floats = npt.NDArray[np.float32]

MIN_VERSION = 330
"""OpenGL 3.3 core: what macOS, Mesa's software renderer and old integrated GPUs all have."""


class GlError(SwingsError):
    """OpenGL cannot start, or cannot hold the stream."""


class Target(Enum):
    """What a pixel of the picture is blended in; the value is moderngl's name."""

    FLOAT32 = "f4"
    """As the CPU renderer does: for measurements and captures."""
    FLOAT16 = "f2"
    """Finer than any screen at half the memory traffic: for windows."""
    BYTE = "f1"
    """8 bits a channel: the fastest, but every layer that is blended is rounded and clipped."""


def open_context() -> moderngl.Context:
    """A context of its own, without a window or a display, current in this thread."""
    # Elsewhere than on Linux the default back end needs no display.
    backend: dict[str, Any] = {"backend": "egl"} if sys.platform.startswith("linux") else {}
    try:
        return moderngl.create_context(require=MIN_VERSION, standalone=True, **backend)
    except Exception as error:  # moderngl and glcontext raise bare Exception
        reason = " ".join(str(error).split()) or type(error).__name__
        raise GlError(f"OpenGL 3.3 cannot start without a window: {reason}") from error


class _Unlocked:
    """The two calls that take long, made so that other threads run meanwhile.

    moderngl keeps the interpreter's lock during a call, ctypes does not. A software renderer works
    inside them: with the lock it would starve the update thread for most of a frame.
    """

    def __init__(self, context: moderngl.Context) -> None:
        macos = "/System/Library/Frameworks/OpenGL.framework/OpenGL"
        self._context = context
        self._library: ctypes.CDLL | None = None
        try:
            library = ctypes.CDLL({"linux": "libGL.so.1", "darwin": macos}[sys.platform])
            draw, finish = library.glDrawArraysInstanced, library.glFinish
        except (KeyError, OSError, AttributeError):
            return  # moderngl's own calls do the same
        draw.argtypes = (ctypes.c_uint, ctypes.c_int, ctypes.c_int, ctypes.c_int)
        draw.restype = finish.restype = None
        self._library = library

    def draw_quads(self, quads: moderngl.VertexArray, count: int) -> None:
        if self._library is None:
            quads.render(moderngl.TRIANGLE_STRIP, vertices=4, instances=count)
            return
        # No instance at all: this only binds the program and its buffers.
        quads.render(moderngl.TRIANGLE_STRIP, vertices=4, instances=0)
        self._library.glDrawArraysInstanced(moderngl.TRIANGLE_STRIP, 0, 4, count)

    def finish(self) -> None:
        """Waits until everything is drawn."""
        if self._library is None:
            self._context.finish()
        else:
            self._library.glFinish()


class GlRenderer:
    """Draws a stream in recipe v1; see renderer.Renderer."""

    def __init__(
        self,
        manifest: Manifest,
        target: Target = Target.FLOAT32,
        context: moderngl.Context | None = None,
    ) -> None:
        """context: one that is current in this thread, such as a window's; None opens one."""
        self._manifest = manifest
        self._target = target
        # A context of its own is made current for each call, as two renderers may share a thread.
        self._context = open_context() if context is None else context
        self._own = context is None
        self._current: AbstractContextManager[object] = (
            self._context if self._own else nullcontext()
        )
        self._lanes = PackedLanes(manifest.swin_size, manifest.slice_size, manifest.sh_degree)
        self._lane_slots = self._lanes.lane_rows * self._lanes.columns
        self._order = Order(manifest.swin_size, self._lane_slots)
        self._arrivals: Arrivals[PackedSlice] = Arrivals()
        self._packing = threading.Lock()
        self._closed = False
        self.uploaded_bytes = 0
        self._unlocked = _Unlocked(self._context)
        self._framebuffer: moderngl.Framebuffer | None = None
        try:
            with self._current:
                self._make_resident()
        except Exception as error:  # a driver's refusal is a bare moderngl.Error
            self.close()
            if isinstance(error, SwingsError):
                raise
            reason = " ".join(str(error).split())
            raise GlError(f"OpenGL refuses what the renderer needs: {reason}") from error

    def _make_resident(self) -> None:
        context, manifest, lanes = self._context, self._manifest, self._lanes
        # What Python drops is freed at the next frame, by the thread that owns the context.
        context.gc_mode = "context_gc"
        height_px = lanes.lane_rows * manifest.swin_size
        info = context.info
        self.name = f"OpenGL, {info['GL_RENDERER']}"
        self._limit_px = min(info["GL_MAX_TEXTURE_SIZE"], *info["GL_MAX_VIEWPORT_DIMS"])
        if max(height_px, TEXTURE_WIDTH_PX) > self._limit_px:
            raise GlError(
                f"{manifest.num_gs} Gaussians need a texture of {TEXTURE_WIDTH_PX}x{height_px}; "
                f"this OpenGL takes {self._limit_px}"
            )
        self._texture = context.texture((lanes.columns * lanes.texels, height_px), 4, dtype="u4")
        self._texture.filter = (moderngl.NEAREST, moderngl.NEAREST)
        self._program = self._compile("splat.glsl")
        self._slots = context.buffer(reserve=4 * manifest.swin_size * self._lane_slots)
        self._quads = context.vertex_array(self._program, [(self._slots, "1i/i", "slot")])
        self._copy = context.vertex_array(self._compile("screen.glsl"), [])

    def _compile(self, shader: str) -> moderngl.Program:
        source = (files("player.render") / "shaders" / shader).read_text(encoding="utf-8")
        constants = {
            "TEXELS": self._lanes.texels,
            "COLUMNS": self._lanes.columns,
            "SH_DEGREE": min(self._manifest.sh_degree, recipe.MAX_SH_DEGREE),
            "SH_C1": recipe.SH_C1,
            "LOW_PASS_PX2": recipe.LOW_PASS_PX2,
            "MAX_EXTENT_SIGMA": recipe.MAX_EXTENT_SIGMA,
            "ALPHA_MIN": recipe.ALPHA_MIN,
            "ALPHA_MAX": recipe.ALPHA_MAX,
        }
        lines = [f"#define {name} {value!r}" for name, value in constants.items()]
        head = "\n".join(["#version 330 core", *lines])
        return self._context.program(
            vertex_shader=f"{head}\n#define VERTEX_STAGE\n{source}",
            fragment_shader=f"{head}\n#define FRAGMENT_STAGE\n{source}",
        )

    def put(self, slice: Slice) -> None:
        """Packs the slice for the GPU; the next `upload` of a frame >= its birth takes it there."""
        check_slice(slice, self._manifest.slice_size, self._manifest.sh_degree)
        with self._packing:
            self._arrivals.put(slice.birth, self._lanes.pack(slice))

    def forget_waiting(self) -> None:
        """See Renderer."""
        with self._packing:
            for packed in self._arrivals.drop():
                self._lanes.forget(packed.lane)

    def upload(self, frame: int) -> None:
        """Brings the slices born up to `frame` into their lanes; nothing else is touched."""
        with self._current:
            self._upload(frame)

    def _upload(self, frame: int) -> None:
        for packed in self._arrivals.take(frame):
            self._order.put(packed.lane, packed.expire, packed.means, packed.starts, packed.rows)
            for patch in packed.patches:
                height_px, width_px, _ = patch.texels.shape
                area = (patch.x_px, patch.y_px, width_px, height_px)
                self._texture.write(patch.texels, viewport=area)
                self.uploaded_bytes += patch.texels.nbytes

    def draw(self, frame: int, camera: Camera, framebuffer: moderngl.Framebuffer) -> None:
        """Draws `frame` from what is uploaded over a black `framebuffer`, without waiting for the
        GPU; the context is current.

        Row 0 of the picture goes into row 0 of the target, which `read` gives first.
        """
        self._context.gc()
        slots = self._order.far_first(frame, camera.w2c, self._manifest.near_m)
        framebuffer.use()
        framebuffer.clear()
        if not len(slots):
            return
        # Orphaned first: the frame before may still be read from it.
        self._slots.orphan()
        self._slots.write(slots)
        self._set_camera(camera)
        # Premultiplied colours, farthest first.
        self._context.enable_only(moderngl.BLEND)
        self._context.blend_func = moderngl.ONE, moderngl.ONE_MINUS_SRC_ALPHA
        self._texture.use(0)
        self._unlocked.draw_quads(self._quads, len(slots))

    def present(self, frame: int, camera: Camera, screen: moderngl.Framebuffer) -> None:
        """Draws `frame` from what is uploaded onto the lower left of a window, as large as `camera`
        says."""
        with self._current:
            self.draw(frame, camera, self._offscreen(camera.width_px, camera.height_px))
            # A window's framebuffer keeps the size that the window was opened with.
            screen.viewport = (0, 0, camera.width_px, camera.height_px)
            screen.use()
            self._context.enable_only(moderngl.NOTHING)
            self._picture.use(0)
            self._copy.render(moderngl.TRIANGLES, vertices=3)

    def _set_camera(self, camera: Camera) -> None:
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
            uniform = self._program.get(name, None)
            # A compiler leaves out what it finds unused: `position` without linear harmonics.
            if isinstance(uniform, moderngl.Uniform):
                uniform.write(np.ascontiguousarray(value, np.float32))

    def render(self, frame: int, camera: Camera) -> Floats:
        """See Renderer."""
        with self._current:
            self._upload(frame)
            return self._read(frame, camera)

    def render_again(self, frame: int, camera: Camera) -> Floats:
        """See Renderer."""
        with self._current:
            return self._read(frame, camera)

    def _read(self, frame: int, camera: Camera) -> Floats:
        framebuffer = self._offscreen(camera.width_px, camera.height_px)
        self.draw(frame, camera, framebuffer)
        self._unlocked.finish()
        shape = (camera.height_px, camera.width_px, 3)
        if self._target is not Target.BYTE:
            picture = np.empty(shape, np.float32)
            framebuffer.read_into(picture, components=3, dtype="f4")
            return picture
        bytes_read = np.empty(shape, np.uint8)
        framebuffer.read_into(bytes_read, components=3, dtype="f1", alignment=1)
        return bytes_read.astype(np.float32) / np.float32(255)

    def _offscreen(self, width_px: int, height_px: int) -> moderngl.Framebuffer:
        """The target of that size; one of another size is dropped, and freed by the next draw."""
        size = (width_px, height_px)
        if self._framebuffer is None or self._framebuffer.size != size:
            if max(size) > self._limit_px:
                raise GlError(
                    f"this OpenGL draws pictures up to {self._limit_px} pixels wide and high, "
                    f"not {width_px}x{height_px}"
                )
            self._picture = self._context.texture(size, 4, dtype=self._target.value)
            self._framebuffer = self._context.framebuffer([self._picture])
        return self._framebuffer

    def close(self) -> None:
        """Frees everything; closing twice is the same as once."""
        if self._closed:
            return
        self._closed = True
        self._framebuffer = None
        with self._current:
            self._context.gc()
        if self._own:
            self._context.release()
