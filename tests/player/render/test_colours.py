"""Colours of every degree against an independent evaluation, and their re-evaluation."""

from __future__ import annotations

from contextlib import closing
from dataclasses import replace

import numpy as np
import pytest
import torch
from scipy.special import lpmv

from codec.camera import Camera
from codec.similarity import harmonics as codec_harmonics
from codec.slice import Slice
from player.render.cpu import CpuRenderer, render_splats
from player.render.gl import create_renderer
from player.render.project import COLOUR_TURN_RAD
from player.render.renderer import GlVersion, Renderer, RendererKind
from tests.support.hosted_streams import small_manifest
from tests.support.reference_render import (
    cameras_all_round,
    drawn_psnr_db,
    harmonics,
    scattered_splats,
    turned_camera,
)
from tests.support.screen.opengl import GL_VERSIONS

COUNT = 120


def directions(count: int) -> np.ndarray:
    found = np.random.default_rng(5).normal(size=(count, 3))
    unit: np.ndarray = found / np.linalg.norm(found, axis=1, keepdims=True)
    return unit


def test_the_harmonics_are_those_of_legendre() -> None:
    """Order m of degree l: Legendre's function of z, times the cosine or sine of the azimuth."""
    there = directions(50)
    azimuth = np.arctan2(there[:, 1], there[:, 0])
    expected = []
    for degree in range(4):
        for order in range(-degree, degree + 1):
            m = abs(order)
            norm = (2 * degree + 1) / (4 * np.pi)
            for n in range(degree - m + 1, degree + m + 1):
                norm /= n
            wave = np.sin(m * azimuth) if order < 0 else np.cos(m * azimuth)
            # lpmv has the sign (-1)^m, like 3D Gaussian Splatting.
            value = lpmv(m, degree, there[:, 2]) * wave * np.sqrt(norm * (2 if m else 1))
            expected.append(value)
    found = harmonics(torch.tensor(there), 16).numpy()
    np.testing.assert_allclose(found, np.stack(expected, 1), atol=1e-12)
    np.testing.assert_allclose(codec_harmonics(there), found, atol=1e-7)


@pytest.fixture(params=["cpu", *GL_VERSIONS])
def kind(request: pytest.FixtureRequest) -> str:
    return str(request.param)


def opened(kind: str, sh_degree: int = 3) -> Renderer:
    """A renderer for streams with one lane, with nothing uploaded."""
    manifest = small_manifest(COUNT, sh_degree, near_m=0.2, swin_size=1, layers=(1.0,))
    if kind == "cpu":
        return create_renderer(RendererKind.CPU, manifest)
    return create_renderer(RendererKind.GL, manifest, GlVersion(kind))


def whole(sh_degree: int = 3) -> Slice:
    return Slice(0, scattered_splats(COUNT, 3, sh_degree), np.zeros(COUNT, np.uint8))


def shifted(camera: Camera, by_m: float) -> Camera:
    """`camera` moved sideways."""
    w2c = camera.w2c.copy()
    w2c[0, 3] -= by_m
    return replace(camera, w2c=w2c)


@pytest.mark.parametrize("sh_degree", [0, 1, 2, 3])
def test_every_degree_is_drawn_from_anywhere(kind: str, sh_degree: int) -> None:
    """Between near places OpenGL keeps colours, as long as they turn little for the nearest."""
    slice, here, step_m = whole(sh_degree), turned_camera(), 0.3 * COLOUR_TURN_RAD * 0.2
    with closing(opened(kind, sh_degree)) as renderer:
        renderer.put(slice)
        cameras = [*cameras_all_round(8), *(shifted(here, n * step_m) for n in range(9))]
        for camera in (*cameras, shifted(here, 0.3), shifted(here, -0.2)):
            assert drawn_psnr_db(renderer.render(0, camera), slice.splats, camera) > 60
        picture = renderer.render(0, here)  # after a far move every colour is new
        np.testing.assert_allclose(picture, renderer.render(0, here), atol=1e-6)
        if kind == "cpu":
            exact = render_splats(slice.splats, here, 0.2)
            np.testing.assert_allclose(picture, exact, atol=1e-6)


def test_colours_stay_while_the_camera_hardly_moves() -> None:
    slice, here = whole(), turned_camera()
    renderer = opened("cpu")
    assert isinstance(renderer, CpuRenderer)
    renderer.put(slice)
    renderer.render(0, here)
    seen = renderer.seen
    shown = seen.seen_from[:, 0] < 1e3
    assert COUNT / 2 < shown.sum() < COUNT  # the others are outside the picture
    distances = np.linalg.norm(slice.splats.means - here.position, axis=1)
    step_m = 0.9 * COLOUR_TURN_RAD * np.median(distances[shown])
    renderer.render(0, shifted(here, step_m))
    kept = (seen.seen_from == here.position.astype(np.float32)).all(1)[shown]
    # Colours for which the step is a larger turn are evaluated again.
    np.testing.assert_array_equal(kept, step_m <= COLOUR_TURN_RAD * distances[shown])
    # Steps add up, because turns are measured from the place of the last evaluation.
    for n in range(2, 12):
        renderer.render(0, shifted(here, n * step_m))
    turns = np.linalg.norm(seen.seen_from - shifted(here, 11 * step_m).position, axis=1) / distances
    assert turns[shown].max() <= 1.1 * COLOUR_TURN_RAD


def test_what_is_put_in_place_of_others_has_its_own_colours(kind: str) -> None:
    slice, camera = whole(), turned_camera()
    rows = np.arange(0, COUNT, 3, dtype=np.int32)
    splats = replace(slice.splats, sh=slice.splats.sh.copy())
    splats.sh[rows] = scattered_splats(len(rows), 8, 3).sh
    with closing(opened(kind)) as renderer:
        renderer.put(slice)
        renderer.render(0, camera)
        renderer.put(Slice(1, splats.take(rows), np.zeros(len(rows), np.uint8), rows))
        picture = renderer.render(1, camera)
    assert drawn_psnr_db(picture, splats, camera) > 60
    assert drawn_psnr_db(picture, slice.splats, camera) < 30
