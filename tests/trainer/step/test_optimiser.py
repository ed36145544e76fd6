"""Adam equals that of torch, row by row; the noise has the covariance of 3DGS-MCMC."""

from __future__ import annotations

import numpy as np
import pytest

from trainer.step.optimiser import GATE_STEEPNESS, Adam, AgeScaling, OptimiserConfig, add_noise
from trainer.step.raster import Parameters


def round_gaussians(rows: int, opacity: float) -> Parameters:
    values = Parameters.zeros(rows, 0)
    values.quats[:, 0] = 1
    values.log_scales[:] = np.log(0.3)
    values.logit_opacities[:] = np.log(opacity / (1 - opacity))
    return values


def test_the_noise_has_the_covariance_sigma_squared() -> None:
    """means += Sigma xi, so the shift's covariance is amount^2 gate^2 Sigma^2."""
    rows = 200_000
    values = round_gaussians(rows, 0.005)
    values.log_scales[:] = np.log([0.5, 0.2, 0.1])
    quat = np.array([0.8, 0.1, -0.5, 0.3], np.float32)
    values.quats[:] = 3 * quat  # any norm
    start = values.means.copy()
    add_noise(
        *values.arrays[:4], np.arange(rows, dtype=np.int32), np.float32(0.7), np.float32(0.005),
        np.float32(GATE_STEEPNESS), 42,
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
        values = round_gaussians(100, opacity)
        add_noise(
            *values.arrays[:4],
            rows,
            np.float32(1),
            np.float32(0.005),
            np.float32(GATE_STEEPNESS),
            seed,
        )
        return values.means

    assert (noisy(0.5, 1) == round_gaussians(100, 0.5).means).all()
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
def test_age_scales_the_update_or_only_the_gradient(mode: AgeScaling, ratio: float) -> None:
    """Scaling the gradient cancels in Adam's first step; scaling the update is a lower rate."""
    config = OptimiserConfig(age_scaling=mode)
    values, gradients = Parameters.zeros(2, 0), Parameters.zeros(2, 0)
    gradients.means[:] = 1
    ages = np.array([0, 3], np.float32)
    Adam(2, 0, config).step(values, gradients, np.arange(2, dtype=np.int32), 0.1, ages)
    assert values.means[1, 0] / values.means[0, 0] == pytest.approx(ratio, rel=1e-4)
