"""The loss, compared with plain torch."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from codec.arrays import Bytes, Doubles, Floats
from player.render.project import TILE_PX
from trainer.step.loss import C1, C2, TAPS, Loss, Workspace, photometric_loss, psnr_db, ssim


def gradients(loss: Loss) -> tuple[Floats, Floats, Floats]:
    assert loss.gain_grad is not None
    assert loss.bias_grad is not None
    return loss.picture_grad, loss.gain_grad, loss.bias_grad


def ssim_map_reference(pred: torch.Tensor, target: torch.Tensor) -> torch.Tensor:
    taps = torch.tensor(TAPS, dtype=pred.dtype)
    kernel = torch.outer(taps, taps)[None, None].expand(3, 1, 11, 11)

    def blur(x: torch.Tensor) -> torch.Tensor:
        return torch.nn.functional.conv2d(x[None], kernel, padding=5, groups=3)[0]

    mu_p, mu_t = blur(pred), blur(target)
    var_p, var_t = blur(pred * pred) - mu_p**2, blur(target * target) - mu_t**2
    cov = blur(pred * target) - mu_p * mu_t
    return ((2 * mu_p * mu_t + C1) * (2 * cov + C2)) / (
        (mu_p**2 + mu_t**2 + C1) * (var_p + var_t + C2)
    )


@pytest.mark.parametrize("masked", [False, True])
@pytest.mark.parametrize("dssim_weight", [0.0, 0.2, 1.0])
def test_value_and_gradients_are_the_references(dssim_weight: float, masked: bool) -> None:
    """Ignored pixels are grey in both pictures."""
    rng = np.random.default_rng(0)
    picture = rng.random((3, 32, 48)).astype(np.float32)  # padded
    target = rng.random((3, 25, 41)).astype(np.float32)
    gain = np.array([1.1, 0.9, 1.0], np.float32)
    bias = np.array([0.02, -0.03, 0.0], np.float32)
    mask = some_mask(25, 41) if masked else np.ones((25, 41), np.uint8)

    leaves = [
        torch.tensor(a, dtype=torch.float64, requires_grad=True) for a in (picture, gain, bias)
    ]
    counts, grey = torch.tensor(mask > 0), torch.tensor(0.5, dtype=torch.float64)
    corrected = leaves[0][:, :25, :41] * leaves[1][:, None, None] + leaves[2][:, None, None]
    pred = torch.where(counts, corrected, grey)
    goal = torch.where(counts, torch.tensor(target, dtype=torch.float64), grey)
    wrong = 1 - ssim_map_reference(pred, goal).mean()
    loss = (1 - dssim_weight) * (pred - goal).abs().mean() + dssim_weight * wrong
    torch.autograd.backward(loss)

    for given in (mask, mask > 0, 0.7 * mask.astype(np.float32)) if masked else (None,):
        got = photometric_loss(picture, target, dssim_weight, gain, bias, None, given)
        assert got.value == pytest.approx(loss.item(), rel=1e-5)
        for ours, leaf in zip(gradients(got), leaves, strict=True):
            assert leaf.grad is not None
            np.testing.assert_allclose(ours, leaf.grad.numpy(), rtol=2e-3, atol=2e-7)
        assert (got.picture_grad[:, :25, :41][:, mask == 0] == 0).all()
        assert (got.picture_grad[:, 25:] == 0).all()
        assert (got.picture_grad[:, :, 41:] == 0).all()


def some_mask(height: int, width: int) -> Bytes:
    """A mask that ignores a hole, a border and single pixels."""
    mask = (np.random.default_rng(9).random((height, width)) > 0.1).astype(np.uint8)
    mask[5:12, 8:20] = 0
    mask[:, -3:] = 0
    return mask


def test_gradient_with_a_mask_against_finite_differences() -> None:
    rng = np.random.default_rng(3)
    target = rng.random((3, 25, 41)).astype(np.float32)
    # Never nearer than the step to the target: L1 has a kink there.
    away = np.where(rng.random(target.shape) < 0.5, -1, 1) * rng.uniform(0.1, 0.3, target.shape)
    picture = (target + away).astype(np.float32)
    gain, bias, mask = np.ones(3, np.float32), np.zeros(3, np.float32), some_mask(25, 41)

    def value(step: Doubles) -> float:
        moved = (picture + step).astype(np.float32)
        return photometric_loss(moved, target, 0.5, gain, bias, None, mask).value

    gradient = photometric_loss(picture, target, 0.5, gain, bias, None, mask).picture_grad
    for _ in range(4):
        direction = np.sign(gradient) * rng.uniform(0.2, 1, target.shape)
        direction[:, mask == 0] = rng.uniform(-1, 1, (3, int((mask == 0).sum())))
        slope = (value(0.01 * direction) - value(-0.01 * direction)) / 0.02
        assert slope == pytest.approx(float((gradient * direction).sum()), rel=2e-3)


def test_what_a_mask_ignores_may_be_anything() -> None:
    rng = np.random.default_rng(4)
    picture = rng.random((3, 40, 60)).astype(np.float32)
    target = rng.random((3, 33, 52)).astype(np.float32)
    gain, bias = np.full(3, 1.2, np.float32), np.full(3, -0.1, np.float32)
    mask = some_mask(33, 52)
    work = Workspace(target.shape)

    def loss(picture: Floats, target: Floats, mask: Bytes | None) -> list[bytes]:
        got = photometric_loss(picture, target, 0.2, gain, bias, work, mask)
        return [np.float64(got.value).tobytes(), *(a.tobytes() for a in gradients(got))]

    other_picture, other_target = picture.copy(), target.copy()
    other_picture[:, :33, :52][:, mask == 0] = 7
    other_target[:, mask == 0] = np.nan
    first = loss(picture, target, mask)
    assert loss(other_picture, other_target, mask) == first
    assert np.isnan(other_target).any()  # the caller's target is unchanged
    unmasked = loss(picture, target, None)
    assert unmasked != first
    assert loss(picture, target, np.ones_like(mask)) == unmasked


@pytest.mark.parametrize("masked", [False, True])
def test_some_tiles_have_their_part_of_the_value_and_the_same_gradient(masked: bool) -> None:
    rng = np.random.default_rng(6)
    height, width, dssim_weight = 75, 173, 0.3
    picture = rng.random((3, 80, 176)).astype(np.float32)
    target = rng.random((3, height, width)).astype(np.float32)
    mask = some_mask(height, width) if masked else None
    one, zero = np.ones(3, np.float32), np.zeros(3, np.float32)
    active = np.zeros((5, 11), np.bool_)
    active[1, 3:5] = active[4, 10] = active[0, 0] = True
    inside = active.repeat(TILE_PX, axis=0).repeat(TILE_PX, axis=1)
    whole = photometric_loss(picture, target, dssim_weight, one, zero, None, mask)
    # Pixels beyond the tiles' neighbours are undefined.
    known = np.zeros_like(inside)
    for y, x in np.argwhere(active):
        known[max(y - 1, 0) * TILE_PX : (y + 2) * TILE_PX][
            :, max(x - 1, 0) * TILE_PX : (x + 2) * TILE_PX
        ] = True
    assert 0.3 < known.mean() < 0.7
    some = np.where(known, picture, np.float32(np.nan))
    got = photometric_loss(some, target, dssim_weight, one, zero, None, mask, active)
    assert np.array_equal(got.picture_grad[:, inside], whole.picture_grad[:, inside])

    counts = np.ones((height, width), np.bool_) if mask is None else mask > 0
    pred, goal = (
        torch.tensor(np.where(counts, p[:, :height, :width], 0.5).astype(np.float64))
        for p in (picture, target)
    )
    wrong = (1 - dssim_weight) * (pred - goal).abs() + dssim_weight * (
        1 - ssim_map_reference(pred, goal)
    )
    inside = inside[:height, :width]
    assert got.value == pytest.approx(float(wrong.numpy()[:, inside].sum()) / wrong.numel(), 1e-5)
    assert got.covered == inside.mean()
    assert (got.gain_grad, got.bias_grad) == (None, None)
    nothing = photometric_loss(
        some, target, dssim_weight, one, zero, None, mask, np.zeros_like(active)
    )
    assert (nothing.value, nothing.covered) == (0, 0)


def test_metrics_of_all_pixels_and_of_those_that_count() -> None:
    rng = np.random.default_rng(5)
    picture, target = (rng.random((25, 41, 3)).astype(np.float32) for _ in range(2))
    mask = some_mask(25, 41)
    kept = picture.copy(), target.copy()
    counts = mask > 0
    error = (picture.astype(np.float64) - target)[counts]
    assert psnr_db(picture, target, mask) == pytest.approx(-10 * np.log10((error**2).mean()))
    other = picture.copy()
    other[~counts] = 9
    assert psnr_db(other, target, mask) == psnr_db(picture, target, mask)
    assert ssim(other, target, mask) == ssim(picture, target, mask)
    every = np.ones_like(mask)
    assert psnr_db(picture, target, every) == psnr_db(picture, target)
    assert ssim(picture, target, every) == pytest.approx(ssim(picture, target), abs=1e-6)
    grey = [np.where(counts[..., None], p, 0.5).transpose(2, 0, 1) for p in (picture, target)]
    reference = ssim_map_reference(*(torch.tensor(p, dtype=torch.float64) for p in grey)).numpy()
    assert ssim(picture, target, mask) == pytest.approx(reference[:, counts].mean(), abs=1e-5)
    assert ssim(picture, target, mask) != pytest.approx(reference.mean(), abs=1e-3)
    for nothing in (psnr_db, ssim):
        assert np.isnan(nothing(picture, target, np.zeros_like(mask)))
    assert ssim(picture, picture) == pytest.approx(1, abs=1e-5)
    assert psnr_db(picture, picture) == 100
    assert psnr_db(picture, picture + np.float32(0.1)) == pytest.approx(20, abs=1e-3)
    pair = [torch.tensor(p.transpose(2, 0, 1)) for p in kept]
    expected = float(ssim_map_reference(*pair).mean())
    assert ssim(picture, target) == pytest.approx(expected, abs=1e-5)
    # Planar pictures seen as (H, W, 3): their memory must not be written to.
    planar = [np.ascontiguousarray(p.transpose(2, 0, 1)).transpose(1, 2, 0) for p in kept]
    assert ssim(planar[0], planar[1], mask) == ssim(picture, target, mask)
    for array, before in zip((picture, target, *planar), kept * 2, strict=True):
        assert np.array_equal(array, before)
