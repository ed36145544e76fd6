"""Checks whether OpenGL starts on this machine, for tests that need it."""

from __future__ import annotations

import pytest

from player.render.gl import GlError, open_context
from player.render.renderer import GlVersion


def gl_reason(version: GlVersion) -> str | None:
    """The reason why this OpenGL cannot start here; None if it can."""
    try:
        open_context(version).release()
    except GlError as error:
        return str(error)
    return None


NO_GL = gl_reason(GlVersion.V33)
needs_gl = pytest.mark.skipif(NO_GL is not None, reason=f"OpenGL: {NO_GL}")

NO_GL43 = gl_reason(GlVersion.V43)
GL_VERSIONS = [
    pytest.param(GlVersion.V33, marks=needs_gl),
    pytest.param(
        GlVersion.V43, marks=pytest.mark.skipif(NO_GL43 is not None, reason=f"OpenGL: {NO_GL43}")
    ),
]
"""Both versions of OpenGL, as parameters."""
