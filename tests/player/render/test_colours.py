"""Colours of every degree against an independent evaluation, and their re-evaluation."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
from scipy.special import lpmv

from codec.camera import Camera
from codec.similarity import harmonics as codec_harmonics
from codec.slice import Slice
from player.render.cpu import CpuRenderer, render_splats
from player.render.recipe import COLOUR_TURN_RAD
from tests.support.hosted_streams import small_manifest
from tests.support.reference_render import (
    cameras_all_round,
    drawn_psnr_db,
    harmonics,
    scattered_splats,
    turned_camera,
)

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


@pytest.mark.parametrize("sh_degree", [0, 1, 2, 3])
def test_every_degree_is_drawn(sh_degree: int) -> None:
    splats = scattered_splats(COUNT, 3, sh_degree)
    for camera in cameras_all_round(8):
        assert drawn_psnr_db(render_splats(splats, camera, 0.2), splats, camera) > 60


def shifted(camera: Camera, by_m: float) -> Camera:
    """`camera` moved sideways."""
    w2c = camera.w2c.copy()
    w2c[0, 3] -= by_m
    return replace(camera, w2c=w2c)


def opened(sh_degree: int) -> tuple[CpuRenderer, Slice]:
    manifest = small_manifest(COUNT, sh_degree, near_m=0.2, swin_size=1, layers=(1.0,))
    whole = Slice(0, scattered_splats(COUNT, 3, sh_degree), np.zeros(COUNT, np.uint8))
    return CpuRenderer(manifest), whole


def fresh(whole: Slice, camera: Camera) -> np.ndarray:
    """The picture of a renderer that gets the slice for the first time."""
    return render_splats(whole.splats, camera, 0.2)


@pytest.mark.parametrize("sh_degree", [0, 1, 2, 3])
def test_after_a_far_move_every_colour_is_new(sh_degree: int) -> None:
    renderer, whole = opened(sh_degree)
    renderer.put(whole)
    for by_m in (0.0, 0.3, -0.2, 0.0):
        camera = shifted(turned_camera(), by_m)
        np.testing.assert_array_equal(renderer.render(0, camera), fresh(whole, camera))


def test_colours_stay_while_the_camera_hardly_moves() -> None:
    renderer, whole = opened(3)
    renderer.put(whole)
    here = turned_camera()
    renderer.render(0, here)
    seen = renderer.seen
    shown = seen.seen_from[:, 0] < 1e3
    assert COUNT / 2 < shown.sum() < COUNT  # the others are outside the picture
    distances = np.linalg.norm(whole.splats.means - here.position, axis=1)
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


def test_what_is_put_in_place_of_others_has_its_own_colours() -> None:
    renderer, whole = opened(3)
    renderer.put(whole)
    camera = turned_camera()
    renderer.render(0, camera)
    rows = np.arange(0, COUNT, 3, dtype=np.int32)
    sh = whole.splats.sh.copy()
    sh[rows] = scattered_splats(len(rows), 8, 3).sh
    splats = replace(whole.splats, sh=sh)
    renderer.put(Slice(1, splats.take(rows), np.zeros(len(rows), np.uint8), rows))
    changed = Slice(0, splats, whole.start_offsets)
    np.testing.assert_allclose(renderer.render(1, camera), fresh(changed, camera), atol=1e-6)
    assert np.abs(fresh(changed, camera) - fresh(whole, camera)).max() > 0.1
