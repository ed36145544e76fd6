"""Adam is torch's, row by row; noise of 3DGS-MCMC; common gradients of a cell."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from codec.camera import rotation_of
from trainer.step.optimiser import (
    GATE_STEEPNESS,
    LOG_SCALES_LR,
    LOGIT_OPACITIES_LR,
    QUATS_LR,
    SH_LR,
    Adam,
    AgeScaling,
    OptimiserConfig,
    add_noise,
    cells_of,
    move_together,
)
from trainer.step.raster import Parameters


def round_gaussians(rows: int, opacity: float) -> Parameters:
    values = Parameters.zeros(rows, 0)
    values.quats[:, 0] = 1
    values.log_scales[:] = np.log(0.3)
    values.logit_opacities[:] = np.log(opacity / (1 - opacity))
    return values


def noisy(values: Parameters, amount: float, seed: int) -> np.ndarray:
    """The means after noise."""
    add_noise(
        *values.arrays[:4], np.arange(len(values.means), dtype=np.int32), np.float32(amount),
        np.float32(0.005), np.float32(GATE_STEEPNESS), seed,
    )  # fmt: skip
    return values.means


def test_the_noise_has_the_covariance_sigma_squared() -> None:
    """means += Sigma xi, so the shift's covariance is amount^2 gate^2 Sigma^2."""
    values = round_gaussians(200_000, 0.005)
    values.log_scales[:] = np.log([0.5, 0.2, 0.1])
    quat = np.array([0.8, 0.1, -0.5, 0.3])
    values.quats[:] = 3 * quat  # any norm
    moved = noisy(values, 0.7, 42).astype(np.float64)
    rotation = rotation_of(quat / np.linalg.norm(quat))
    sigma = rotation @ np.diag([0.25, 0.04, 0.01]) @ rotation.T
    expected = (0.7 * 0.5) ** 2 * sigma @ sigma  # the gate is one half at its own opacity
    assert np.abs(moved.mean(axis=0)).max() < 1e-3
    np.testing.assert_allclose(np.cov(moved.T), expected, atol=0.02 * expected.max())


def test_opaque_gaussians_get_no_noise_and_the_same_seed_gives_the_same() -> None:
    opaque, *faint = (
        noisy(round_gaussians(100, opacity), 1, seed)
        for opacity, seed in ((0.5, 1), (0.01, 1), (0.01, 1), (0.01, 2))
    )
    assert (opaque == 0).all()
    assert (faint[0] == faint[1]).all()
    assert (faint[0] != faint[2]).any()


def test_adam_is_torchs_and_leaves_other_rows_alone() -> None:
    rng = np.random.default_rng(0)
    config = OptimiserConfig(age_scaling="off")
    values, gradients = Parameters.zeros(6, 1), Parameters.zeros(6, 1)
    leaves = [torch.zeros(4, *a.shape[1:], requires_grad=True) for a in values.arrays]
    rates = [0.01, LOG_SCALES_LR, QUATS_LR, LOGIT_OPACITIES_LR, SH_LR]
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
def test_age_scales_the_update_or_only_the_gradient(mode: AgeScaling, ratio: float) -> None:
    """Scaling the gradient cancels in Adam's first step; scaling the update is a lower rate."""
    config = OptimiserConfig(age_scaling=mode)
    values, gradients = Parameters.zeros(2, 0), Parameters.zeros(2, 0)
    gradients.means[:] = 1
    ages = np.array([0, 3], np.float32)
    Adam(2, 0, config).step(values, gradients, np.arange(2, dtype=np.int32), 0.1, ages)
    assert values.means[1, 0] / values.means[0, 0] == pytest.approx(ratio, rel=1e-4)


@given(st.integers(1, 60), st.floats(0.05, 3), st.integers(0, 99))
def test_a_cell_holds_what_lies_in_its_cube(count: int, size_m: float, seed: int) -> None:
    means = np.random.default_rng(seed).normal(size=(count, 3)).astype(np.float32)
    cells = cells_of(means, size_m)
    cubes = [tuple(cube) for cube in np.floor(means / np.float32(size_m)).astype(int)]
    for i in range(count):
        for j in range(count):
            assert (cells[i] == cells[j]) == (cubes[i] == cubes[j])


def test_gradients_are_summed_over_those_that_move() -> None:
    gradients = np.arange(12, dtype=np.float32).reshape(4, 3)
    before = gradients.copy()
    cells = np.array([0, 1, 0, 0], np.int32)
    move_together(gradients, np.array([0, 1, 3], np.int32), cells)
    assert (gradients[0] == before[0] + before[3]).all()
    assert (gradients[3] == gradients[0]).all()
    assert (gradients[1] == before[1]).all()
    assert (gradients[2] == before[2]).all()  # kept: it stands still
