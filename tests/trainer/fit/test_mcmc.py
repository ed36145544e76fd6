"""Relocation and noise as mathematics."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from codec.camera import Camera
from player.render.recipe import ALPHA_MAX
from trainer.fit.mcmc import MAX_COPIES, relocate, split_opacity_and_scale
from trainer.fit.optimiser import Adam, OptimiserConfig, add_noise
from trainer.step.raster import Parameters, View, render


@given(st.floats(0.01, 0.99), st.integers(1, MAX_COPIES))
def test_copies_together_are_as_opaque_as_the_one_they_replace(opacity: float, copies: int) -> None:
    new, factor = split_opacity_and_scale(np.array([opacity]), np.array([copies]), 1e-9)
    assert 1 - (1 - new[0]) ** copies == pytest.approx(opacity, rel=1e-6)
    if copies == 1:
        assert factor[0] == pytest.approx(1)
    else:
        assert 0 < factor[0] <= 1


@given(st.floats(0.05, 0.95), st.integers(2, 12))
def test_the_scale_keeps_the_integral_of_a_line_through_the_gaussian(
    opacity: float, copies: int
) -> None:
    """The formula's promise, by quadrature: the blended opacity of the copies, integrated along a
    line through their common centre, is the old Gaussian's."""
    new, factor = split_opacity_and_scale(np.array([opacity]), np.array([copies]), 1e-9)
    x = np.linspace(-12, 12, 20001)
    before = opacity * np.exp(-0.5 * x**2)
    after = 1 - (1 - new[0] * np.exp(-0.5 * (x / factor[0]) ** 2)) ** copies
    assert after.sum() == pytest.approx(before.sum(), rel=1e-4)


def lone_gaussian(rows: int, opacity: float) -> Parameters:
    values = Parameters.zeros(rows, 0)
    values.quats[:, 0] = 1
    values.log_scales[:] = np.log(0.3)
    values.logit_opacities[:] = np.log(opacity / (1 - opacity))
    values.means[:] = (0, 0, 3)
    values.sh[:, 0] = 1.0
    return values


def test_relocation_keeps_the_rendered_picture() -> None:
    camera = Camera("c", 64, 64, 60.0, 60.0, 32.0, 32.0, np.eye(4))
    view = View.prepare(camera, 0.2)
    for opacity in (0.3, 0.7, 0.95):
        values = lone_gaussian(4, opacity)
        values.means[1:] = (50, 50, 3)  # the dead, elsewhere
        values.logit_opacities[1:] = -9
        rows = np.arange(4, dtype=np.int32)
        before = render(values, rows, view).picture
        targets = relocate(values, np.arange(1, 4), np.array([0]), 0.005, np.random.default_rng(0))
        assert (targets == 0).all()
        after = render(values, rows, view).picture
        assert opacity < ALPHA_MAX
        # The formula keeps the integral along a line, not each pixel: a few per cent at the rim.
        assert np.abs(after - before).max() < 0.11 * before.max()
        through_centre = before[0, 31].sum()
        assert after[0, 31].sum() == pytest.approx(through_centre, rel=0.03)


def test_relocation_takes_the_opaque_more_often_and_touches_no_one_else() -> None:
    values = lone_gaussian(300, 0.5)
    values.logit_opacities[:100] = -9  # dead
    values.logit_opacities[100:200] = np.log(0.1 / 0.9)
    values.logit_opacities[200:] = np.log(0.9 / 0.1)
    before = values.log_scales.copy()
    targets = relocate(values, np.arange(100), np.arange(100, 300), 0.005, np.random.default_rng(1))
    assert 80 < (targets >= 200).sum() <= 100  # expected 90
    spared = np.setdiff1d(np.arange(100, 300), targets)
    assert (values.log_scales[spared] == before[spared]).all()
    for dead, target in enumerate(targets):
        assert values.logit_opacities[dead] == values.logit_opacities[target]
        assert (values.log_scales[dead] == values.log_scales[target]).all()


def test_relocation_without_dead_or_living_does_nothing() -> None:
    values = lone_gaussian(4, 0.5)
    before = [a.copy() for a in values.arrays]
    rng = np.random.default_rng(0)
    none = np.zeros(0, np.int64)
    assert len(relocate(values, none, np.arange(4), 0.005, rng)) == 0
    assert len(relocate(values, np.arange(4), none, 0.005, rng)) == 0
    for a, b in zip(values.arrays, before, strict=True):
        assert (a == b).all()


def test_the_noise_has_the_covariance_sigma_squared() -> None:
    """means += Sigma xi, so the shift's covariance is amount^2 gate^2 Sigma^2."""
    rows = 200_000
    values = lone_gaussian(rows, 0.005)
    values.log_scales[:] = np.log([0.5, 0.2, 0.1])
    quat = np.array([0.8, 0.1, -0.5, 0.3], np.float32)
    values.quats[:] = 3 * quat  # any norm
    start = values.means.copy()
    add_noise(
        *values.arrays[:4], np.arange(rows, dtype=np.int32), np.float32(0.7), np.float32(0.005),
        np.float32(100), 42,
    )  # fmt: skip
    moved = (values.means - start).astype(np.float64)
    w, x, y, z = quat / np.linalg.norm(quat)
    rotation = np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )
    sigma = rotation @ np.diag([0.25, 0.04, 0.01]) @ rotation.T
    expected = (0.7 * 0.5) ** 2 * sigma @ sigma  # the gate is one half at its own opacity
    assert np.abs(moved.mean(axis=0)).max() < 1e-3
    np.testing.assert_allclose(np.cov(moved.T), expected, atol=0.02 * expected.max())


def test_opaque_gaussians_get_no_noise_and_the_same_seed_gives_the_same() -> None:
    rows = np.arange(100, dtype=np.int32)

    def noisy(opacity: float, seed: int) -> np.ndarray:
        values = lone_gaussian(100, opacity)
        add_noise(*values.arrays[:4], rows, np.float32(1), np.float32(0.005), np.float32(100), seed)
        return values.means

    assert (noisy(0.5, 1) == lone_gaussian(100, 0.5).means).all()
    assert (noisy(0.01, 1) == noisy(0.01, 1)).all()
    assert (noisy(0.01, 1) != noisy(0.01, 2)).any()


def test_adam_is_torchs_and_leaves_other_rows_alone() -> None:
    import torch

    rng = np.random.default_rng(0)
    config = OptimiserConfig(age_scaling="off")
    values, gradients = Parameters.zeros(6, 1), Parameters.zeros(6, 1)
    leaves = [torch.zeros(4, *a.shape[1:], requires_grad=True) for a in values.arrays]
    rates = [0.01, config.log_scales_lr, config.quats_lr, config.logit_opacities_lr, config.sh_lr]
    theirs = torch.optim.Adam(
        [{"params": [p], "lr": lr} for p, lr in zip(leaves, rates, strict=True)], eps=config.eps
    )
    ours = Adam(6, 1, config)
    for _ in range(20):
        for array, leaf in zip(gradients.arrays, leaves, strict=True):
            array[:] = rng.normal(size=array.shape)
            leaf.grad = torch.tensor(array[:4])
        theirs.step()
        ours.step(values, gradients, np.arange(4, dtype=np.int32), 0.01, np.zeros(6, np.float32))
    for array, leaf in zip(values.arrays[:4], leaves[:4], strict=True):
        np.testing.assert_allclose(array[:4], leaf.detach().numpy(), rtol=1e-4, atol=1e-6)
        assert (array[4:] == 0).all()
    sh = leaves[4].detach().numpy()
    np.testing.assert_allclose(values.sh[:4, 0], sh[:, 0], rtol=1e-4, atol=1e-6)
    np.testing.assert_allclose(values.sh[:4, 1:], sh[:, 1:] / 20, rtol=1e-4, atol=1e-6)


@pytest.mark.parametrize(("mode", "ratio"), [("off", 1.0), ("gradient", 1.0), ("update", 0.25)])
def test_age_scales_the_update_or_only_the_gradient(mode: str, ratio: float) -> None:
    """Scaling the gradient cancels in Adam's first step; scaling the update is a lower rate."""
    config = OptimiserConfig(age_scaling=mode)  # type: ignore[arg-type]
    values, gradients = Parameters.zeros(2, 0), Parameters.zeros(2, 0)
    gradients.means[:] = 1
    ages = np.array([0, 3], np.float32)
    Adam(2, 0, config).step(values, gradients, np.arange(2, dtype=np.int32), 0.1, ages)
    assert values.means[1, 0] / values.means[0, 0] == pytest.approx(ratio, rel=1e-4)
