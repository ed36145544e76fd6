"""The choice of a renderer."""

from __future__ import annotations

import logging

from codec.stream.manifest import Manifest

from ..renderer import GlVersion, Renderer, RendererKind, check_drawable
from .glcontext import GlError
from .glrenderer import GlRenderer

log = logging.getLogger(__name__)


def create_renderer(
    kind: RendererKind, manifest: Manifest, version: GlVersion = GlVersion.AUTO
) -> Renderer:
    """A renderer for the stream of `manifest`, to be used by the calling thread.

    AUTO takes the CPU, and logs why, where OpenGL cannot start.
    Raises UnsupportedError when the recipe cannot draw the stream, GlError when OpenGL, or one
    version of it, is asked for and cannot start.
    """
    check_drawable(manifest)
    if kind is RendererKind.CPU:
        return _on_cpu(manifest)
    try:
        return GlRenderer(manifest, version=version)
    except GlError as error:
        if kind is RendererKind.GL or version is not GlVersion.AUTO:
            raise
        log.warning("drawing on the CPU: %s", error)
        return _on_cpu(manifest)


def _on_cpu(manifest: Manifest) -> Renderer:
    from ..cpu import CpuRenderer  # its kernels load slowly, and a window has no use for them

    return CpuRenderer(manifest)
