"""Drawing with OpenGL: 3.3 with a texture, 4.3 with buffers and compute shaders."""

from .context import GlError, Target, first_context, open_context
from .glrenderer import GlRenderer, create_renderer, with_what_works

__all__ = [
    "GlError",
    "GlRenderer",
    "Target",
    "create_renderer",
    "first_context",
    "open_context",
    "with_what_works",
]
