"""Whether OpenGL starts on this machine, for tests that need it."""

from __future__ import annotations

import pytest

from player.render.gl import GlError, open_context


def gl_reason() -> str | None:
    """Why OpenGL cannot start here; None where it can."""
    try:
        open_context().release()
    except GlError as error:
        return str(error)
    return None


NO_GL = gl_reason()
needs_gl = pytest.mark.skipif(NO_GL is not None, reason=f"OpenGL: {NO_GL}")
