"""The choice of the renderer, and limits of the recipe."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest

from codec.arrays import Floats
from codec.errors import InvalidError, UnsupportedError
from player.render.gl import GlError, create_renderer
from player.render.renderer import Renderer, RendererKind
from tests.support.hosted_streams import SWIN_SIZE, random_slice, small_manifest
from tests.support.screen.opengl import needs_gl

KINDS = [
    pytest.param(kind, marks=[needs_gl] if kind is RendererKind.GL else [])
    for kind in (RendererKind.CPU, RendererKind.GL)
]


@pytest.fixture(params=KINDS)
def renderer(request: pytest.FixtureRequest) -> Iterator[Renderer]:
    opened = create_renderer(request.param, small_manifest(slice_size=40))
    yield opened
    opened.close()


def test_what_the_recipe_cannot_draw() -> None:
    with pytest.raises(UnsupportedError, match="antialias"):
        create_renderer(RendererKind.CPU, small_manifest(antialias=True))


def put_window(renderer: Renderer, births: range) -> None:
    for birth in births:
        renderer.put(random_slice(birth, 40))


def pictures(renderer: Renderer, frames: range) -> list[Floats]:
    return [renderer.render(frame, CAMERA) for frame in frames]


CAMERA = small_manifest().camera()


def test_a_frame_is_drawn_again_whatever_waits(renderer: Renderer) -> None:
    put_window(renderer, range(1 - SWIN_SIZE, 1))
    shown = renderer.render(0, CAMERA)
    put_window(renderer, range(1, 6))
    uploaded_bytes = renderer.uploaded_bytes
    np.testing.assert_array_equal(renderer.render_again(0, CAMERA), shown)
    assert renderer.uploaded_bytes == uploaded_bytes
    renderer.upload(5)
    assert renderer.uploaded_bytes > uploaded_bytes
    np.testing.assert_array_equal(renderer.render_again(5, CAMERA), renderer.render(5, CAMERA))


def test_what_waits_is_forgotten_and_another_place_is_drawn(renderer: Renderer) -> None:
    fresh = create_renderer(type_of(renderer), small_manifest(slice_size=40))
    put_window(fresh, range(3 - SWIN_SIZE, 4))
    expected = pictures(fresh, range(2, 4))
    fresh.close()
    # Far ahead, with some slices still waiting; then back before all of them.
    put_window(renderer, range(50 - SWIN_SIZE, 52))
    shown = renderer.render(49, CAMERA)
    put_window(renderer, range(52, 56))
    renderer.forget_waiting()
    np.testing.assert_array_equal(renderer.render_again(49, CAMERA), shown)
    put_window(renderer, range(3 - SWIN_SIZE, 4))
    np.testing.assert_array_equal(pictures(renderer, range(2, 4)), expected)


def type_of(renderer: Renderer) -> RendererKind:
    return RendererKind.CPU if renderer.name == "CPU" else RendererKind.GL


def test_what_follows_a_forgotten_slice_is_refused(renderer: Renderer) -> None:
    put_window(renderer, range(1 - SWIN_SIZE, 1))
    renderer.upload(0)
    renderer.put(random_slice(1, 40))
    renderer.forget_waiting()
    change = replace(random_slice(1 + SWIN_SIZE, 40), rows=np.arange(40, dtype=np.int32))

    def follow() -> None:
        renderer.put(change)
        renderer.upload(1 + SWIN_SIZE)

    with pytest.raises(InvalidError, match="changes the one born at 1; its lane holds"):
        follow()


def test_without_opengl_auto_says_so_and_gl_fails(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    def refuse(*_: object, **__: object) -> None:
        raise RuntimeError("no display")

    monkeypatch.setattr("moderngl.create_standalone_context", refuse)
    monkeypatch.setattr("moderngl.create_context", refuse)
    with pytest.raises(GlError, match=r"^OpenGL 3.3 cannot start: .*no display"):
        create_renderer(RendererKind.GL, small_manifest())
    assert create_renderer(RendererKind.AUTO, small_manifest()).name == "CPU"
    assert "drawing on the CPU: OpenGL 3.3 cannot start" in caplog.text
