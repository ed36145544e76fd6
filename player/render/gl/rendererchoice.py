"""The choice of a renderer."""

from __future__ import annotations

import logging
from collections.abc import Callable
from typing import TypeVar

from codec.stream.manifest import Manifest

from ..renderer import GlVersion, Renderer, RendererKind, check_drawable
from .glcontext import GlError
from .glrenderer import GlRenderer

log = logging.getLogger(__name__)

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
