"""Colours of every degree drawn with OpenGL, against an independent evaluation in float64."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest

from codec.camera import Camera
from codec.slice import Slice
from player.render.gl import GlRenderer
from player.render.recipe import COLOUR_TURN_RAD
from player.render.renderer import GlVersion
from tests.support.hosted_streams import small_manifest
from tests.support.reference_render import (
    cameras_all_round,
    drawn_psnr_db,
    scattered_splats,
    turned_camera,
)
from tests.support.screen.opengl import GL_VERSIONS

COUNT = 120
WHOLE = Slice(0, scattered_splats(COUNT, 3, 3), np.zeros(COUNT, np.uint8))


@pytest.fixture(params=GL_VERSIONS)
def renderer(request: pytest.FixtureRequest) -> Iterator[GlRenderer]:
    """A renderer for streams of degree 3 with one lane, with nothing uploaded."""
    manifest = small_manifest(COUNT, 3, near_m=0.2, swin_size=1, layers=(1.0,))
    opened = GlRenderer(manifest, version=GlVersion(request.param))
    yield opened
    opened.close()


def test_every_degree_is_drawn(renderer: GlRenderer) -> None:
    renderer.put(WHOLE)
    for camera in cameras_all_round(8):
        assert drawn_psnr_db(renderer.render(0, camera), WHOLE.splats, camera) > 60


def test_what_changes_has_its_own_colours(renderer: GlRenderer) -> None:
    renderer.put(WHOLE)
    camera = turned_camera()
    renderer.render(0, camera)
    rows = np.arange(0, COUNT, 3, dtype=np.int32)
    splats = replace(WHOLE.splats, sh=WHOLE.splats.sh.copy())
    splats.sh[rows] = scattered_splats(len(rows), 8, 3).sh
    renderer.put(Slice(1, splats.take(rows), np.zeros(len(rows), np.uint8), rows))
    picture = renderer.render(1, camera)
    assert drawn_psnr_db(picture, splats, camera) > 60
    assert drawn_psnr_db(picture, WHOLE.splats, camera) < 30


def shifted(camera: Camera, by_m: float) -> Camera:
    """`camera` moved sideways."""
    w2c = camera.w2c.copy()
    w2c[0, 3] -= by_m
    return replace(camera, w2c=w2c)


def test_colours_follow_the_camera_in_steps(renderer: GlRenderer) -> None:
    """Between steps, colours are those of a place within the stated turn for the nearest ones."""
    renderer.put(WHOLE)
    here, step_m = turned_camera(), 0.3 * COLOUR_TURN_RAD * 0.2
    renderer.render(0, here)
    for n in range(1, 9):
        camera = shifted(here, n * step_m)
        assert drawn_psnr_db(renderer.render(0, camera), WHOLE.splats, camera) > 60
    far = shifted(here, 0.3)
    picture = renderer.render(0, far)
    assert drawn_psnr_db(picture, WHOLE.splats, far) > 60
    np.testing.assert_array_equal(picture, renderer.render(0, far))
