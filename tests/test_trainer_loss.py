"""The loss against plain torch."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from trainer.loss import C1, C2, TAPS, photometric_loss, psnr_db, ssim


def ssim_reference(pred: torch.Tensor, target: torch.Tensor) -> torch.Tensor:
    taps = torch.tensor(TAPS, dtype=pred.dtype)
    kernel = torch.outer(taps, taps)[None, None].expand(3, 1, 11, 11)

    def blur(x: torch.Tensor) -> torch.Tensor:
        return torch.nn.functional.conv2d(x[None], kernel, padding=5, groups=3)[0]

    mu_p, mu_t = blur(pred), blur(target)
    var_p, var_t = blur(pred * pred) - mu_p**2, blur(target * target) - mu_t**2
    cov = blur(pred * target) - mu_p * mu_t
    return (
        ((2 * mu_p * mu_t + C1) * (2 * cov + C2))
        / ((mu_p**2 + mu_t**2 + C1) * (var_p + var_t + C2))
    ).mean()


@pytest.mark.parametrize("dssim_weight", [0.0, 0.2, 1.0])
def test_value_and_gradients_are_the_references(dssim_weight: float) -> None:
    rng = np.random.default_rng(0)
    picture = rng.random((3, 32, 48)).astype(np.float32)  # padded
    target = rng.random((3, 25, 41)).astype(np.float32)
    gain = np.array([1.1, 0.9, 1.0], np.float32)
    bias = np.array([0.02, -0.03, 0.0], np.float32)

    leaves = [
        torch.tensor(a, dtype=torch.float64, requires_grad=True) for a in (picture, gain, bias)
    ]
    pred = leaves[0][:, :25, :41] * leaves[1][:, None, None] + leaves[2][:, None, None]
    goal = torch.tensor(target, dtype=torch.float64)
    loss = (1 - dssim_weight) * (pred - goal).abs().mean() + dssim_weight * (
        1 - ssim_reference(pred, goal)
    )
    torch.autograd.backward(loss)

    got = photometric_loss(picture, target, dssim_weight, gain, bias)
    assert got.value == pytest.approx(loss.item(), rel=1e-5)
    for ours, leaf in zip((got.picture_grad, got.gain_grad, got.bias_grad), leaves, strict=True):
        assert leaf.grad is not None
        np.testing.assert_allclose(ours, leaf.grad.numpy(), rtol=2e-3, atol=2e-7)
    assert (got.picture_grad[:, 25:] == 0).all()
    assert (got.picture_grad[:, :, 41:] == 0).all()


def test_metrics_of_a_picture_and_itself() -> None:
    rng = np.random.default_rng(1)
    picture = rng.random((20, 30, 3)).astype(np.float32)
    assert ssim(picture, picture) == pytest.approx(1, abs=1e-5)
    assert psnr_db(picture, picture) == 100
    assert psnr_db(picture, picture + np.float32(0.1)) == pytest.approx(20, abs=1e-3)
    other = rng.random((20, 30, 3)).astype(np.float32)
    expected = ssim_reference(
        torch.tensor(picture.transpose(2, 0, 1)), torch.tensor(other.transpose(2, 0, 1))
    )
    assert ssim(picture, other) == pytest.approx(float(expected), abs=1e-5)
