"""Drawing with OpenGL: the window stays on the GPU, and a frame uploads what its slice changes; and
the choice of a renderer.

Rule: one thread makes a GlRenderer, draws with it and closes it; only `put` and `forget_waiting`
may come from others, and they make no GL call.
"""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable
from contextlib import AbstractContextManager, nullcontext
from typing import Any, TypeVar

import moderngl

from codec.arrays import Floats
from codec.camera import Camera
from codec.errors import SwingsError
from codec.slice import Slice
from codec.stream.manifest import Manifest
from player.render.cpu import StepTimes, step
from player.render.renderer import GlVersion, Renderer, RendererKind, check_drawable
from player.render.upload import Arrivals, check_slice

from .context import (
    BLACK,
    Colour,
    DepthPixel,
    GlError,
    Offscreen,
    Target,
    Unlocked,
    open_context,
    version_for,
)
from .resident import BufferResident, Resident, TextureResident

log = logging.getLogger(__name__)


class GlRenderer:
    """Draws a stream in recipe v1; see renderer.Renderer."""

    def __init__(
        self,
        manifest: Manifest,
        target: Target = Target.FLOAT32,
        context: moderngl.Context | None = None,
        version: GlVersion = GlVersion.AUTO,
    ) -> None:
        """context: one that is current in this thread, such as a window's; None opens one.

        Raises GlError.
        """
        self._manifest = manifest
        # A context of its own is made current for each call, as two renderers may share a thread.
        self._context = open_context(version) if context is None else context
        self._own = context is None
        self._current: AbstractContextManager[object] = (
            self._context if self._own else nullcontext()
        )
        self._arrivals: Arrivals[Any] = Arrivals()  # as its packer packs them
        self._packing = threading.Lock()
        self._closed = False
        self.uploaded_bytes = 0
        self.times: StepTimes | None = None
        self.alpha = False
        self._pixel: DepthPixel | None = None  # for who asks how far a pixel is
        try:
            with self._current:
                # What Python drops is freed at the next frame, by the thread that owns the context.
                self._context.gc_mode = "context_gc"
                self.version = version_for(self._context, version)
                self._unlocked = Unlocked(self._context)
                self._offscreen = Offscreen(self._context, target)
                self._resident = self._make_resident(version)
                self.name = f"OpenGL {self.version}, {self._context.info['GL_RENDERER']}"
                self._packer = self._resident.packer
        except Exception as error:  # a driver's refusal is a bare moderngl.Error
            self._release()
            if isinstance(error, SwingsError):
                raise
            reason = " ".join(str(error).split())
            raise GlError(f"this OpenGL cannot run the renderer: {reason}") from error

    def _make_resident(self, asked: GlVersion) -> Resident:
        if self.version is GlVersion.V43:
            try:
                return BufferResident(self._context, self._manifest)
            except (GlError, moderngl.Error) as error:
                if asked is not GlVersion.AUTO:
                    raise
                log.warning("drawing with OpenGL 3.3: %s", " ".join(str(error).split()))
                self.version = GlVersion.V33
        return TextureResident(self._context, self._manifest)

    def put(self, slice: Slice) -> None:
        """Packs the slice for the GPU; the next `upload` of a frame >= its birth takes it there."""
        check_slice(slice, self._manifest.slice_size, self._manifest.sh_degree)
        with self._packing:
            self._arrivals.append(slice.birth, self._packer.pack(slice))

    def forget_waiting(self) -> None:
        """See Renderer."""
        with self._packing:
            for packed in self._arrivals.drop():
                self._packer.forget(packed.lane)

    def upload(self, frame: int) -> None:
        """Brings the slices born up to `frame` into their lanes; nothing else is touched."""
        with self._current:
            self._upload(frame)

    def _upload(self, frame: int) -> None:
        with step(self.times, "upload_ms", self._unlocked.finish):
            self._move(1.0)
            taken = self._arrivals.pop_until(frame)
            for packed in taken:
                self.uploaded_bytes += self._resident.upload(packed)
            self._resident.start_glide(frame)

    def glide(self, share: float) -> bool:
        """See Renderer."""
        with self._current, step(self.times, "upload_ms", self._unlocked.finish):
            return self._move(share)

    def _move(self, share: float) -> bool:
        num_bytes = self._resident.glide(share)
        self.uploaded_bytes += num_bytes or 0
        return num_bytes is not None

    def _draw(self, frame: int, camera: Camera) -> None:
        """Draws `frame` from what is uploaded, without waiting for the GPU."""
        self._context.gc()
        with step(self.times, "sort_ms", self._unlocked.finish):
            self._resident.sort(frame, camera)
        with step(self.times, "draw_ms", self._unlocked.finish):
            self._offscreen.clear(camera)
            self._blend(camera)

    def _blend(self, camera: Camera, depths: bool = False) -> None:
        # Premultiplied, farthest first.
        self._context.enable_only(moderngl.BLEND)
        self._context.blend_func = moderngl.ONE, moderngl.ONE_MINUS_SRC_ALPHA
        self._resident.draw(camera, depths)

    def present(
        self,
        frame: int,
        camera: Camera,
        screen: moderngl.Framebuffer,
        background: Colour = BLACK,
    ) -> None:
        """Draws `frame` from what is uploaded onto the lower left of a window, as large as `camera`
        says. background: what shows where the Gaussians let light through."""
        with self._current:
            self._draw(frame, camera)
            self._offscreen.show(screen, background)

    def depth_at(self, camera: Camera, x_px: float, y_px: float) -> float | None:
        """Depth of the picture that was drawn last, with `camera`, metres forward from it; None if
        hardly anything shows there. Waits for the GPU. x_px, y_px: from the upper left."""
        with self._current:
            self._pixel = self._pixel or DepthPixel(self._context)
            moved = self._pixel.use(camera, x_px, y_px)
            self._blend(moved, depths=True)
            self._unlocked.finish()
            return self._pixel.depth_m()

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
        self._draw(frame, camera)
        self._unlocked.finish()
        return self._offscreen.read(4 if self.alpha else 3)

    def close(self) -> None:
        """Frees everything; closing twice is the same as once."""
        if self._closed:
            return
        self._closed = True
        del self._offscreen, self._resident, self._pixel
        self._release()

    def _release(self) -> None:
        with self._current:
            self._context.gc()
        if self._own:
            self._context.release()


Result = TypeVar("Result")


def with_what_works(
    kind: RendererKind, version: GlVersion, make: Callable[[RendererKind], Result]
) -> Result:
    """What `make` gives for `kind`. For AUTO with GL, or with the CPU where OpenGL cannot start,
    which is logged. Raises GlError when OpenGL, or one version of it, is asked for and cannot."""
    if kind is RendererKind.CPU:
        return make(RendererKind.CPU)
    try:
        return make(RendererKind.GL)
    except GlError as error:
        if kind is RendererKind.GL or version is not GlVersion.AUTO:
            raise
        log.warning("drawing on the CPU: %s", error)
        return make(RendererKind.CPU)


def create_renderer(
    kind: RendererKind, manifest: Manifest, version: GlVersion = GlVersion.AUTO
) -> Renderer:
    """A renderer for the stream of `manifest`, to be used by the calling thread.

    See `with_what_works`; raises UnsupportedError when the recipe cannot draw the stream.
    """
    check_drawable(manifest)

    def make(kind: RendererKind) -> Renderer:
        if kind is RendererKind.GL:
            return GlRenderer(manifest, version=version)
        from ..cpu import CpuRenderer  # its kernels load slowly, and a window has no use for them

        return CpuRenderer(manifest)

    return with_what_works(kind, version, make)
