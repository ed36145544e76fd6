"""The CPU rasteriser and contributions, against a torch reference and differences."""

from __future__ import annotations

import numba
import numpy as np
import pytest
import torch
from torch import Tensor

from codec.camera import Camera
from codec.splats import ARRAY_NAMES, SH_C0, Splats
from player.render.cpu import render_splats
from tests.support.reference_render import render_reference, scattered_splats, turned_camera
from trainer.step.contribution import contribution
from trainer.step.raster import Parameters, Rendered, View, backward, render

NEAR_M = 0.2


def leaves_of(splats: Splats) -> tuple[Tensor, Tensor, Tensor, Tensor, Tensor]:
    doubles = (torch.tensor(a, dtype=torch.float64, requires_grad=True) for a in splats.arrays)
    means, log_scales, quats, logits, sh = doubles
    return means, log_scales, quats, logits, sh


@pytest.mark.parametrize("sh_degree", [0, 1, 2, 3])
@pytest.mark.parametrize("seed", [0, 1])
def test_the_picture_is_the_references(sh_degree: int, seed: int) -> None:
    splats, cam = scattered_splats(120, seed, sh_degree), turned_camera()
    with torch.no_grad():
        expected = render_reference(*leaves_of(splats), cam, NEAR_M).numpy()
    got = render_splats(splats, cam, NEAR_M)
    mse = float(np.mean((got - expected) ** 2))
    assert expected.max() > 0.5
    assert -10 * np.log10(mse) > 80


@pytest.mark.parametrize("sh_degree", [0, 1, 2, 3])
def test_gradients_are_the_references(sh_degree: int) -> None:
    splats, cam = scattered_splats(80, 3, sh_degree), turned_camera()
    rng = np.random.default_rng(7)
    weights = rng.normal(size=(cam.height_px, cam.width_px, 3)).astype(np.float32)

    leaves = leaves_of(splats)
    picture = render_reference(*leaves, cam, NEAR_M)
    torch.autograd.backward((picture * torch.tensor(weights)).sum())

    values, view = Parameters(*splats.arrays), View.prepare(cam, NEAR_M)
    rows = np.arange(len(splats), dtype=np.int32)
    rendered = render(values, rows, view)
    picture_grad = np.zeros_like(rendered.picture)
    picture_grad[:, : cam.height_px, : cam.width_px] = weights.transpose(2, 0, 1)
    gradients = Parameters.zeros(len(splats), sh_degree)
    backward(rendered, values, picture_grad, len(splats), gradients)

    for got, leaf in zip(gradients.arrays, leaves, strict=True):
        assert leaf.grad is not None
        expected = leaf.grad.numpy()
        scale = np.abs(expected).max()
        assert scale > 0
        # The order of near-equal thresholds (1/255, 1e-4) may flip single pixels in float32.
        error = np.abs(got - expected)
        assert np.quantile(error, 0.99) < 2e-4 * scale
        assert error.max() < 5e-3 * scale


@pytest.mark.parametrize("name", ARRAY_NAMES)
def test_gradients_are_the_slopes_of_the_kernels_own_picture(name: str) -> None:
    """Central differences through the float32 kernels, along random directions."""
    splats, cam = scattered_splats(12, 5, sh_degree=3), turned_camera()
    # Opaque, so that the cut at alpha = 1/255, whose jump has no gradient, matters little.
    splats.logit_opacities[:] = np.abs(splats.logit_opacities) + 1.5
    rng = np.random.default_rng(11)
    # With smooth weights the cut at 1/255 does not matter.
    v, u = np.mgrid[0 : cam.height_px, 0 : cam.width_px].astype(np.float32)
    weights = np.stack([np.sin(u / 9), np.cos(v / 7), np.sin((u + v) / 11)], -1) / 100
    view, rows = View.prepare(cam, NEAR_M), np.arange(len(splats), dtype=np.int32)

    def loss(values: Parameters) -> float:
        picture = render(values, rows, view).picture[:, : cam.height_px, : cam.width_px]
        return float((picture.transpose(1, 2, 0).astype(np.float64) * weights).sum())

    values = Parameters(*splats.arrays)
    rendered = render(values, rows, view)
    picture_grad = np.zeros_like(rendered.picture)
    picture_grad[:, : cam.height_px, : cam.width_px] = weights.transpose(2, 0, 1)
    gradients = Parameters.zeros(len(splats), 3)
    backward(rendered, values, picture_grad, len(splats), gradients)

    gradient = getattr(gradients, name).astype(np.float64)
    for _ in range(3):
        direction = rng.normal(size=gradient.shape)
        direction /= np.linalg.norm(direction)
        step = 5e-3

        def moved(sign: int, direction: np.ndarray = direction, step: float = step) -> Parameters:
            changed = dict(zip(ARRAY_NAMES, values.arrays, strict=True))
            changed[name] = (changed[name] + sign * step * direction).astype(np.float32)
            return Parameters(**changed)

        slope = (loss(moved(+1)) - loss(moved(-1))) / (2 * step)
        near = 0.03 * float(np.linalg.norm(gradient))
        assert slope == pytest.approx(float((gradient * direction).sum()), rel=0.03, abs=near)


def test_frozen_rows_get_no_gradient_and_regularisers_reach_hidden_rows() -> None:
    splats, cam = scattered_splats(20, 9), turned_camera()
    values, view = Parameters(*splats.arrays), View.prepare(cam, NEAR_M)
    values.means[0] = (0, 0, -50)  # behind the camera
    rendered = render(values, np.arange(20, dtype=np.int32), view)
    gradients = Parameters.zeros(20, 0)
    gradients.means[10:] = 7
    backward(rendered, values, np.ones_like(rendered.picture), 10, gradients, 20, 60)
    assert (gradients.means[10:] == 7).all()
    assert (gradients.means[0] == 0).all()
    opacity = splats.opacities[0]
    assert gradients.logit_opacities[0] == pytest.approx(opacity * (1 - opacity), rel=1e-5)
    np.testing.assert_allclose(gradients.log_scales[0], np.exp(splats.log_scales[0]), rtol=1e-5)


def test_what_is_frozen_hides_all_the_same() -> None:
    splats, cam = scattered_splats(200, 4, sh_degree=1, logit=1.0), turned_camera()
    values, view = Parameters(*splats.arrays), View.prepare(cam, NEAR_M)
    rows = np.random.default_rng(2).permutation(200).astype(np.int32)
    rendered = render(values, rows, view)
    picture_grad = np.random.default_rng(3).normal(size=rendered.picture.shape).astype(np.float32)
    every, some = Parameters.zeros(200, 1), Parameters.zeros(200, 1)
    backward(rendered, values, picture_grad, 200, every, 0.1, 0.1)
    backward(rendered, values, picture_grad, 30, some, 0.1, 0.1)
    for a, b in zip(some.arrays, every.arrays, strict=True):
        assert not a[30:].any()
        np.testing.assert_allclose(a[:30], b[:30], rtol=1e-4, atol=1e-6 * np.abs(b).max())


def rendered(splats: Splats, cam: Camera) -> Rendered:
    rows = np.arange(len(splats), dtype=np.int32)
    return render(Parameters(*splats.arrays), rows, View.prepare(cam, NEAR_M))


def test_ignored_pixels_add_nothing() -> None:
    cam = turned_camera()
    drawn = rendered(scattered_splats(60, 2, logit=-1.0), cam)
    rng = np.random.default_rng(1)
    parts = rng.integers(0, 2, (cam.height_px, cam.width_px), dtype=np.uint8)
    one, other = contribution(drawn, parts), contribution(drawn, 1 - parts)
    np.testing.assert_allclose(one + other, contribution(drawn), atol=1e-3)
    assert one.sum() == pytest.approx(contribution(drawn).sum() / 2, rel=0.1)
    assert not contribution(drawn, np.zeros_like(parts)).any()


@pytest.mark.parametrize(("count", "logit"), [(80, -1.0), (400, 4.0)])
def test_contribution_is_the_slope_of_the_picture_by_colour(count: int, logit: float) -> None:
    """The dense scene transmits so little light that the threshold ends pixels."""
    splats, cam = scattered_splats(count, 6, logit=logit), turned_camera()
    splats.sh[:] = 0.1  # far from black, where the colour would be clipped
    leaves = leaves_of(splats)
    torch.autograd.backward(render_reference(*leaves, cam, NEAR_M)[..., 0].sum())
    assert leaves[4].grad is not None
    expected = leaves[4].grad[:, 0, 0].numpy() / SH_C0
    error = np.abs(contribution(rendered(splats, cam)) - expected)
    # A pixel near 1/255 or the threshold may be on the other side in float32.
    assert error.max() < 0.02
    assert np.quantile(error, 0.9) < 1e-3
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
