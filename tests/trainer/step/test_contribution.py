"""Contributions are the blending weights, and sum up to the light."""

from __future__ import annotations

import numba
import numpy as np
import numpy.typing as npt
import pytest
import torch

from codec.camera import Camera
from codec.splats import SH_C0, Splats
from player.render.recipe import ALPHA_MAX, ALPHA_MIN, TRANSMITTANCE_MIN
from tests.support.reference_render import render_reference, scattered_splats, turned_camera
from trainer.step.contribution import contribution
from trainer.step.raster import Parameters, Rendered, View, render

NEAR_M = 0.2
Doubles = npt.NDArray[np.float64]


def rendered(splats: Splats, cam: Camera) -> Rendered:
    rows = np.arange(len(splats), dtype=np.int32)
    return render(Parameters(*splats.arrays), rows, View.prepare(cam, NEAR_M))


def plain_blend(drawn: Rendered) -> tuple[Doubles, Doubles]:
    """Weights summed by Gaussian, and (H, W) remaining transmittance, in float64, per pixel."""
    cam = drawn.view.camera
    v, u = np.mgrid[0 : cam.height_px, 0 : cam.width_px] + 0.5
    seen = np.ones((cam.height_px, cam.width_px))
    is_open = np.ones(seen.shape, np.bool_)
    sums = np.zeros(len(drawn.rows))
    depths = drawn.projection.depths
    for i in np.argsort(depths):
        if not np.isfinite(depths[i]):
            continue
        x, y, a, b, c, opacity = drawn.projection.projected[i, :6].astype(np.float64)
        dx, dy = u - x, v - y
        alpha = np.minimum(
            ALPHA_MAX, opacity * np.exp(-(a * dx * dx + c * dy * dy) / 2 - b * dx * dy)
        )
        shows = is_open & (alpha >= ALPHA_MIN)
        ends = shows & (seen * (1 - alpha) < TRANSMITTANCE_MIN)
        is_open &= ~ends
        weight = np.where(shows & ~ends, seen * alpha, 0)
        sums[i] = weight.sum()
        seen -= weight
    return sums, seen


@pytest.mark.parametrize(("count", "logit"), [(60, -1.0), (400, 4.0)])
def test_it_is_the_weight_of_a_plain_blend(count: int, logit: float) -> None:
    drawn = rendered(scattered_splats(count, 2, logit=logit), turned_camera())
    expected, left = plain_blend(drawn)
    got = contribution(drawn)
    # The dense scene transmits so little light that the threshold ends pixels.
    assert (left < 100 * TRANSMITTANCE_MIN).any() == (logit > 0)
    # A pixel near 1/255 or the threshold may be on the other side in float32.
    assert np.abs(got - expected).max() < 0.02
    assert np.quantile(np.abs(got - expected), 0.9) < 1e-3
    assert expected.max() > 20


def test_ignored_pixels_add_nothing() -> None:
    cam = turned_camera()
    drawn = rendered(scattered_splats(60, 2, logit=-1.0), cam)
    rng = np.random.default_rng(1)
    parts = rng.integers(0, 2, (cam.height_px, cam.width_px), dtype=np.uint8)
    one, other = contribution(drawn, parts), contribution(drawn, 1 - parts)
    np.testing.assert_allclose(one + other, contribution(drawn), atol=1e-3)
    assert one.sum() == pytest.approx(contribution(drawn).sum() / 2, rel=0.1)
    assert not contribution(drawn, np.zeros_like(parts)).any()


def test_it_is_the_slope_of_the_references_picture_by_colour() -> None:
    splats, cam = scattered_splats(80, 6), turned_camera()
    splats.sh[:] = 0.1  # far from black, where the colour would be clipped
    means, scales, quats, logits, sh = (
        torch.tensor(array, dtype=torch.float64) for array in splats.arrays
    )
    sh.requires_grad_()
    red = render_reference(means, scales, quats, logits, sh, cam, NEAR_M)[..., 0]
    torch.autograd.backward(red.sum())
    assert sh.grad is not None
    expected = sh.grad[:, 0, 0].numpy() / SH_C0
    got = contribution(rendered(splats, cam))
    assert np.abs(got - expected).max() < 0.02
    assert expected.max() > 20


def test_what_is_hidden_or_behind_contributes_nothing() -> None:
    splats, cam = scattered_splats(3, 0), turned_camera(0.0)
    splats.means[:] = [(0, 0, 0), (0, 0, 0.5), (0, 0, -5)]
    splats.log_scales[:] = np.log([[2.0] * 3, [0.05] * 3, [0.05] * 3])
    splats.logit_opacities[:] = (9, 9, 9)
    second_wall = Splats.concatenate([splats.take(np.array([0])), splats])
    wall, _, hidden, behind = contribution(rendered(second_wall, cam)).tolist()
    assert wall > 1000
    # Two walls of alpha 0.99 leave 1e-4 of the light.
    assert hidden < 0.01
    assert behind == 0
    assert contribution(rendered(Splats.empty(), cam)).shape == (0,)


def test_any_number_of_threads_gives_the_same_bits() -> None:
    drawn = rendered(scattered_splats(300, 8), turned_camera())
    many = numba.get_num_threads()
    expected = contribution(drawn).tobytes()
    numba.set_num_threads(1)
    try:
        assert contribution(drawn).tobytes() == expected
    finally:
        numba.set_num_threads(many)
