"""The photometric loss and its gradient; SSIM and PSNR of pictures.

loss = (1 - lambda) L1 + lambda (1 - SSIM), the mean over pixels and channels, as in 3D Gaussian
splatting; SSIM with an 11-tap Gaussian window (sigma 1.5 px), zero beyond the border. Pixels that a
mask ignores are the same grey on both sides, so that nothing there pulls and whatever the capture
shows there has no effect.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from numba import prange

from codec.kernel import kernel

Floats = npt.NDArray[np.float32]
Doubles = npt.NDArray[np.float64]
MaskLike = npt.NDArray[np.uint8] | npt.NDArray[np.bool_] | npt.NDArray[np.float32]
"""(H, W): pixels above 0 count."""

IGNORED = 0.5
"""What both sides show where a mask ignores: the middle, so that its edges are the faintest."""

RADIUS_PX = 5
SIGMA_PX = 1.5
C1 = 0.01**2
C2 = 0.03**2

_taps = np.exp(-0.5 * (np.arange(-RADIUS_PX, RADIUS_PX + 1) / SIGMA_PX) ** 2)
TAPS: Floats = (_taps / _taps.sum()).astype(np.float32)
TAPS.setflags(write=False)


@kernel(fastmath=True, parallel=True)
def _blur_products_rows(pred, target, taps, out):  # type: ignore[no-untyped-def]
    """out (5, C, H, W): the rows of p, t, p*p, t*t and p*t, blurred along x."""
    channels, height, width = target.shape
    radius = taps.shape[0] // 2
    for item in prange(channels * height):
        c, y = item // height, item % height
        rows = np.zeros((5, width + 2 * radius), np.float32)
        for x in range(width):
            p, t = pred[c, y, x], target[c, y, x]
            rows[0, x + radius] = p
            rows[1, x + radius] = t
            rows[2, x + radius] = p * p
            rows[3, x + radius] = t * t
            rows[4, x + radius] = p * t
        for m in range(5):
            for x in range(width):
                out[m, c, y, x] = np.float32(0)
            for k in range(taps.shape[0]):
                w = taps[k]
                for x in range(width):
                    out[m, c, y, x] += w * rows[m, x + k]


@kernel(fastmath=True, parallel=True)
def _ssim_columns(blurred, taps, partials, row_sums):  # type: ignore[no-untyped-def]
    """Finishes the blur along y; SSIM's sum per row, and its partial derivatives (3, C, H, W)."""
    _, channels, height, width = blurred.shape
    radius = taps.shape[0] // 2
    c1, c2, two = np.float32(C1), np.float32(C2), np.float32(2)
    for item in prange(channels * height):
        c, y = item // height, item % height
        rows = np.zeros((5, width), np.float32)
        for m in range(5):
            for k in range(taps.shape[0]):
                source = y + k - radius
                if 0 <= source < height:
                    w = taps[k]
                    for x in range(width):
                        rows[m, x] += w * blurred[m, c, source, x]
        total = np.float32(0)
        for x in range(width):
            mu_p, mu_t = rows[0, x], rows[1, x]
            var_p = rows[2, x] - mu_p * mu_p
            var_t = rows[3, x] - mu_t * mu_t
            cov = rows[4, x] - mu_p * mu_t
            a1, a2 = two * mu_p * mu_t + c1, two * cov + c2
            b1, b2 = mu_p * mu_p + mu_t * mu_t + c1, var_p + var_t + c2
            inv = np.float32(1) / (b1 * b2)
            value = a1 * a2 * inv
            total += value
            d_var = -value / b2
            d_cov = two * a1 * inv
            d_mu = two * mu_t * a2 * inv - two * value * mu_p / b1
            partials[0, c, y, x] = d_mu - two * mu_p * d_var - mu_t * d_cov
            partials[1, c, y, x] = d_var
            partials[2, c, y, x] = d_cov
        row_sums[item] = total


@kernel(fastmath=True, parallel=True)
def _blur_rows(maps, taps, out):  # type: ignore[no-untyped-def]
    count, channels, height, width = maps.shape
    radius = taps.shape[0] // 2
    for item in prange(channels * height):
        c, y = item // height, item % height
        row = np.zeros(width + 2 * radius, np.float32)
        for m in range(count):
            for x in range(width):
                row[x + radius] = maps[m, c, y, x]
                out[m, c, y, x] = np.float32(0)
            for k in range(taps.shape[0]):
                w = taps[k]
                for x in range(width):
                    out[m, c, y, x] += w * row[x + k]


@kernel(fastmath=True, parallel=True)
def _gradient_columns(  # type: ignore[no-untyped-def]
    pred, target, blurred, taps, l1_weight, ssim_weight, gradient, l1_sums
):
    """Finishes the blur of the partials along y and adds the gradient of L1."""
    channels, height, width = target.shape
    radius = taps.shape[0] // 2
    two, zero = np.float32(2), np.float32(0)
    for item in prange(channels * height):
        c, y = item // height, item % height
        rows = np.zeros((3, width), np.float32)
        for m in range(3):
            for k in range(taps.shape[0]):
                source = y + k - radius
                if 0 <= source < height:
                    w = taps[k]
                    for x in range(width):
                        rows[m, x] += w * blurred[m, c, source, x]
        total = zero
        for x in range(width):
            p, t = pred[c, y, x], target[c, y, x]
            difference = p - t
            total += abs(difference)
            slope = l1_weight if difference > zero else -l1_weight
            slope = slope if difference != zero else zero
            ssim_slope = rows[0, x] + two * p * rows[1, x] + t * rows[2, x]
            gradient[c, y, x] = slope - ssim_weight * ssim_slope
        l1_sums[item] = total


@kernel(fastmath=True, parallel=True)
def _correct(picture, gain, bias, out):  # type: ignore[no-untyped-def]
    channels, height, width = out.shape
    for item in prange(channels * height):
        c, y = item // height, item % height
        for x in range(width):
            out[c, y, x] = gain[c] * picture[c, y, x] + bias[c]


@kernel(fastmath=True, parallel=True)
def _uncorrect(picture, gradient, gain, picture_grad, gain_sums, bias_sums):  # type: ignore[no-untyped-def]
    channels, height, width = gradient.shape
    for item in prange(channels * height):
        c, y = item // height, item % height
        by_gain, by_bias = np.float32(0), np.float32(0)
        for x in range(width):
            g = gradient[c, y, x]
            by_gain += g * picture[c, y, x]
            by_bias += g
            picture_grad[c, y, x] = gain[c] * g
        gain_sums[item] = by_gain
        bias_sums[item] = by_bias


@kernel(parallel=True)
def _ignore(mask, pred, target, out_pred, out_target):  # type: ignore[no-untyped-def]
    """Both with IGNORED where the mask ignores; out_pred may be pred."""
    channels, height, width = target.shape
    ignored = np.float32(IGNORED)
    for item in prange(channels * height):
        c, y = item // height, item % height
        for x in range(width):
            counts = mask[y, x] > 0
            out_pred[c, y, x] = pred[c, y, x] if counts else ignored
            out_target[c, y, x] = target[c, y, x] if counts else ignored


@kernel(parallel=True)
def _silence(mask, gradient):  # type: ignore[no-untyped-def]
    channels, height, width = gradient.shape
    for item in prange(channels * height):
        c, y = item // height, item % height
        for x in range(width):
            gradient[c, y, x] = gradient[c, y, x] if mask[y, x] > 0 else np.float32(0)


@dataclass(frozen=True, slots=True)
class Loss:
    """The loss of one picture and its gradients."""

    value: float
    picture_grad: Floats  # shape of the picture, zero in its padding
    gain_grad: Floats  # (3,) float32
    bias_grad: Floats  # (3,) float32


class Workspace:
    """Planes that the loss of pictures of one size writes to.

    A step that allocates new ones spends more time in page faults than in the loss.
    """

    def __init__(self, shape: tuple[int, ...]) -> None:
        """shape: (3, H, W) of the targets."""
        self.shape = shape
        self.pred = np.empty(shape, np.float32)
        self.blurred = np.empty((5, *shape), np.float32)
        self.partials = np.empty((3, *shape), np.float32)
        self.gradient = np.empty(shape, np.float32)
        self.picture_grad = np.zeros((0, 0, 0), np.float32)
        self.masked_target = np.zeros((0, 0, 0), np.float32)

    def masked_target_of(self, target: Floats) -> Floats:
        """A plane like the target, made when the first mask comes."""
        if self.masked_target.shape != target.shape:
            self.masked_target = np.empty_like(target)
        return self.masked_target

    def picture_grad_of(self, picture: Floats) -> Floats:
        """The gradient of a padded picture; only its padding is sure to be zero."""
        if self.picture_grad.shape != picture.shape:
            self.picture_grad = np.zeros_like(picture)
        return self.picture_grad


def photometric_loss(
    picture: Floats,
    target: Floats,
    dssim_weight: float,
    gain: Floats,
    bias: Floats,
    workspace: Workspace | None = None,
    mask: MaskLike | None = None,
) -> Loss:
    """Compares gain * picture + bias with `target`.

    picture: (3, >=H, >=W) float32, padded; target: (3, H, W) float32; gain, bias: (3,) float32.
    workspace: of the target's shape, to be reused from call to call; it holds the gradient given.
    mask: (H, W), above 0 where a pixel counts; the others add nothing to the sums and get no
    gradient, and the mean stays over all pixels. None: all count.
    """
    channels, height, width = target.shape
    count = channels * height * width
    work = workspace or Workspace(target.shape)
    pred, blurred, partials, gradient = work.pred, work.blurred, work.partials, work.gradient
    _correct(picture, gain, bias, pred)
    if mask is not None:
        given, target = target, work.masked_target_of(target)
        _ignore(mask, pred, given, pred, target)
    ssim_sums, l1_sums, gain_sums, bias_sums = (
        np.empty(channels * height, np.float32) for _ in range(4)
    )
    _blur_products_rows(pred, target, TAPS, blurred)
    _ssim_columns(blurred, TAPS, partials, ssim_sums)
    _blur_rows(partials, TAPS, blurred[:3])
    _gradient_columns(
        pred, target, blurred, TAPS,
        np.float32((1 - dssim_weight) / count), np.float32(dssim_weight / count),
        gradient, l1_sums,
    )  # fmt: skip
    if mask is not None:
        _silence(mask, gradient)
    picture_grad = work.picture_grad_of(picture)
    _uncorrect(picture, gradient, gain, picture_grad, gain_sums, bias_sums)
    l1 = float(l1_sums.sum(dtype=np.float64)) / count
    dssim = 1 - float(ssim_sums.sum(dtype=np.float64)) / count
    return Loss(
        (1 - dssim_weight) * l1 + dssim_weight * dssim,
        picture_grad,
        gain_sums.reshape(channels, height).sum(axis=1),
        bias_sums.reshape(channels, height).sum(axis=1),
    )


def ssim(picture: Floats, target: Floats, mask: MaskLike | None = None) -> float:
    """Mean SSIM over pixels and channels; both (H, W, 3) float32 in 0..1.

    mask: (H, W), above 0 where a pixel counts: the mean is over those, and the others look alike
    in both pictures. NaN if none counts.
    """
    pred, goal = (np.ascontiguousarray(p.transpose(2, 0, 1)) for p in (picture, target))
    if mask is not None:
        given = pred, goal
        pred, goal = np.empty_like(pred), np.empty_like(goal)
        _ignore(mask, *given, pred, goal)
    blurred = np.empty((5, *goal.shape), np.float32)
    sums = np.empty(goal.shape[0] * goal.shape[1], np.float32)
    _blur_products_rows(pred, goal, TAPS, blurred)
    if mask is not None:
        counts = mask > 0
        return float(_ssim_map(blurred)[:, counts].mean()) if counts.any() else float("nan")
    _ssim_columns(blurred, TAPS, np.empty((3, *goal.shape), np.float32), sums)
    return float(sums.sum(dtype=np.float64)) / goal.size


def _ssim_map(blurred: Floats) -> Doubles:
    """(C, H, W) SSIM of each pixel, as _ssim_columns has it; blurred: (5, C, H, W) along x."""
    height = blurred.shape[2]
    beyond = ((0, 0), (0, 0), (RADIUS_PX, RADIUS_PX), (0, 0))
    padded = np.pad(blurred.astype(np.float64), beyond)
    mu_p, mu_t, pp, tt, pt = sum(
        (float(tap) * padded[:, :, k : k + height] for k, tap in enumerate(TAPS)),
        start=np.zeros(blurred.shape),
    )
    similar = (2 * mu_p * mu_t + C1) * (2 * (pt - mu_p * mu_t) + C2)
    squares = mu_p**2 + mu_t**2
    result: Doubles = similar / ((squares + C1) * (pp + tt - squares + C2))
    return result


def psnr_db(picture: Floats, target: Floats, mask: MaskLike | None = None) -> float:
    """PSNR over all channels and pixels of pictures in 0..1, capped at 100 dB.

    mask: (H, W), above 0 where a pixel counts; None: all do. NaN if none counts.
    """
    if mask is not None:
        counts = mask > 0
        if not counts.any():
            return float("nan")
        picture, target = picture[counts], target[counts]
    mse = float(np.mean((picture.astype(np.float64) - target) ** 2))
    return 100.0 if mse < 1e-10 else -10 * float(np.log10(mse))
