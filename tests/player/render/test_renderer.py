"""Which renderer draws, and what the recipe cannot draw."""

from __future__ import annotations

import logging
import os
import subprocess
import sys

import pytest

from codec.errors import UnsupportedError
from player.render.renderer import RendererKind, check_drawable, create_renderer
from tests.support.commands import ROOT
from tests.support.hosted_streams import small_manifest


def test_what_the_recipe_cannot_draw(caplog: pytest.LogCaptureFixture) -> None:
    with pytest.raises(UnsupportedError, match="antialias"):
        create_renderer(RendererKind.CPU, small_manifest(antialias=True))
    with caplog.at_level(logging.WARNING):
        check_drawable(small_manifest(sh_degree=2))
    assert "degree 2" in caplog.text


WITHOUT_GL = {**os.environ, "__EGL_VENDOR_LIBRARY_FILENAMES": "/nonexistent"}
"""An environment in which libglvnd, where it is, finds no OpenGL."""

CHOOSE = """
import logging, sys
from player.render.renderer import RendererKind, create_renderer
from tests.support.hosted_streams import small_manifest
logging.basicConfig(level=logging.WARNING)
try:
    print(create_renderer(RendererKind(sys.argv[1]), small_manifest()).name)
except Exception as error:
    print(type(error).__name__, error)
"""


def choose(kind: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-c", CHOOSE, kind],
        cwd=ROOT,
        env=WITHOUT_GL,
        capture_output=True,
        text=True,
        timeout=60,
    )


def test_without_opengl_auto_says_so_and_gl_fails() -> None:
    forced = choose("gl")
    if not forced.stdout.startswith("GlError"):
        pytest.skip("this OpenGL does not come through libglvnd, so it cannot be hidden")
    assert "OpenGL 3.3 cannot start without a window" in forced.stdout
    assert forced.stdout.count("\n") == 1
    fallen = choose("auto")
    assert fallen.stdout == "CPU\n"
    assert "drawing on the CPU: OpenGL 3.3 cannot start" in fallen.stderr
