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

from codec.arrays import Doubles, Flags, Floats
from codec.kernel import kernel, prange

from .runs import Looked, Runs

MaskLike = npt.NDArray[np.uint8] | npt.NDArray[np.bool_] | npt.NDArray[np.float32]
"""(H, W): pixels above 0 count."""

IGNORED = 0.5
"""Value of both pictures in ignored pixels: the middle, so that their edges are the faintest."""

RADIUS_PX = 5
SIGMA_PX = 1.5
C1 = 0.01**2
C2 = 0.03**2

_taps = np.exp(-0.5 * (np.arange(-RADIUS_PX, RADIUS_PX + 1) / SIGMA_PX) ** 2)
TAPS: Floats = (_taps / _taps.sum()).astype(np.float32)
TAPS.setflags(write=False)

BLOCK_PX = 64
"""At least what a vector loop takes in one go, and a multiple of it: 8 or 16 floats, four times."""


@kernel(fastmath=True, parallel=True)
def _blur_products_rows(pred, target, taps, rows, starts, bounds, out):  # type: ignore[no-untyped-def]
    """out (5, C, H, W): the rows of p, t, p*p, t*t and p*t, blurred along x, in the runs (see Runs)
    given by rows, starts and bounds."""
    channels, _, width = target.shape
    count, radius = rows.shape[0], taps.shape[0] // 2
    for item in prange(channels * count):
        c, y = item // count, rows[item % count]
        for run in range(starts[y], starts[y + 1]):
            first, end = bounds[run, 0], bounds[run, 1]
            length = end - first
            lines = np.zeros((5, length + 2 * radius), np.float32)
            from_x, to_x = max(first - radius, 0), min(end + radius, width)
            p_line, t_line = pred[c, y, from_x:to_x], target[c, y, from_x:to_x]
            inside = lines[:, from_x - first + radius : to_x - first + radius]
            for x in range(to_x - from_x):
                p, t = p_line[x], t_line[x]
                inside[0, x] = p
                inside[1, x] = t
                inside[2, x] = p * p
                inside[3, x] = t * t
                inside[4, x] = p * t
            for m in range(5):
                blurred = out[m, c, y, first:end]
                for x in range(length):
                    blurred[x] = np.float32(0)
                for k in range(taps.shape[0]):
                    w, line = taps[k], lines[m, k : k + length]
                    for x in range(length):
                        blurred[x] += w * line[x]


@kernel(inline="always")
def _block_bounds(first, end, width):  # type: ignore[no-untyped-def]
    """From `first` to `end`, widened to whole blocks of a row of `width` px.

    Compilers divide in the last few pixels of a loop otherwise than in vectors, to the last bit. A
    loop over whole blocks has the same last few as one over the whole row.
    """
    first = first // BLOCK_PX * BLOCK_PX
    end = (end + BLOCK_PX - 1) // BLOCK_PX * BLOCK_PX
    if end >= width:
        # The last block is at least as long as the others.
        end = width
        first = max(min(first, (width // BLOCK_PX - 1) * BLOCK_PX), 0)
    return first, end


@kernel(fastmath=True, parallel=True)
def _ssim_columns(  # type: ignore[no-untyped-def]
    blurred, taps, rows, starts, bounds, own_starts, own_bounds, whole, partials, row_sums
):
    """Finishes the blur along y: the partial derivatives (3, C, H, W) of SSIM in the runs, and its
    sum per row: over all of the row if `whole`, else over its own runs, which lie within."""
    _, channels, height, width = blurred.shape
    count, radius = rows.shape[0], taps.shape[0] // 2
    c1, c2, two = np.float32(C1), np.float32(C2), np.float32(2)
    for item in prange(channels * count):
        c, y = item // count, rows[item % count]
        from_x, to_x = _block_bounds(bounds[starts[y], 0], bounds[starts[y + 1] - 1, 1], width)
        lines = np.zeros((5, to_x - from_x), np.float32)
        for run in range(starts[y], starts[y + 1]):
            first, end = bounds[run, 0], bounds[run, 1]
            for m in range(5):
                line = lines[m, first - from_x : end - from_x]
                for k in range(taps.shape[0]):
                    source = y + k - radius
                    if 0 <= source < height:
                        w, other = taps[k], blurred[m, c, source, first:end]
                        for x in range(end - first):
                            line[x] += w * other[x]
        to_p, to_pp, to_pt = (
            partials[0, c, y, from_x:to_x],
            partials[1, c, y, from_x:to_x],
            partials[2, c, y, from_x:to_x],
        )
        total = np.float32(0)
        for x in range(to_x - from_x):
            mu_p, mu_t = lines[0, x], lines[1, x]
            var_p = lines[2, x] - mu_p * mu_p
            var_t = lines[3, x] - mu_t * mu_t
            cov = lines[4, x] - mu_p * mu_t
            a1, a2 = two * mu_p * mu_t + c1, two * cov + c2
            b1, b2 = mu_p * mu_p + mu_t * mu_t + c1, var_p + var_t + c2
            inv = np.float32(1) / (b1 * b2)
            value = a1 * a2 * inv
            total += value
            d_var = -value / b2
            d_cov = two * a1 * inv
            d_mu = two * mu_t * a2 * inv - two * value * mu_p / b1
            to_p[x] = d_mu - two * mu_p * d_var - mu_t * d_cov
            to_pp[x] = d_var
            to_pt[x] = d_cov
            lines[0, x] = value
        if not whole:
            total = np.float32(0)
            for run in range(own_starts[y], own_starts[y + 1]):
                line = lines[0, own_bounds[run, 0] - from_x : own_bounds[run, 1] - from_x]
                for x in range(line.shape[0]):
                    total += line[x]
        row_sums[item] = total


@kernel(fastmath=True, parallel=True)
def _blur_rows(maps, taps, rows, starts, bounds, out):  # type: ignore[no-untyped-def]
    planes, channels, _, width = maps.shape
    count, radius = rows.shape[0], taps.shape[0] // 2
    for item in prange(channels * count):
        c, y = item // count, rows[item % count]
        for run in range(starts[y], starts[y + 1]):
            first, end = bounds[run, 0], bounds[run, 1]
            length = end - first
            line = np.zeros(length + 2 * radius, np.float32)
            from_x, to_x = max(first - radius, 0), min(end + radius, width)
            inside = line[from_x - first + radius : to_x - first + radius]
            for m in range(planes):
                given, blurred = maps[m, c, y, from_x:to_x], out[m, c, y, first:end]
                for x in range(to_x - from_x):
                    inside[x] = given[x]
                for x in range(length):
                    blurred[x] = np.float32(0)
                for k in range(taps.shape[0]):
                    w, shifted = taps[k], line[k : k + length]
                    for x in range(length):
                        blurred[x] += w * shifted[x]


@kernel(fastmath=True, parallel=True)
def _gradient_columns(  # type: ignore[no-untyped-def]
    pred, target, blurred, taps, l1_weight, ssim_weight, rows, starts, bounds, gradient, l1_sums
):
    """Finishes the blur of the partials along y and adds the gradient of L1, in the runs."""
    channels, height, _ = target.shape
    count, radius = rows.shape[0], taps.shape[0] // 2
    two, zero = np.float32(2), np.float32(0)
    for item in prange(channels * count):
        c, y = item // count, rows[item % count]
        total = zero
        for run in range(starts[y], starts[y + 1]):
            first, end = bounds[run, 0], bounds[run, 1]
            lines = np.zeros((3, end - first), np.float32)
            for m in range(3):
                line = lines[m]
                for k in range(taps.shape[0]):
                    source = y + k - radius
                    if 0 <= source < height:
                        w, other = taps[k], blurred[m, c, source, first:end]
                        for x in range(end - first):
                            line[x] += w * other[x]
            p_line, t_line = pred[c, y, first:end], target[c, y, first:end]
            slopes = gradient[c, y, first:end]
            for x in range(end - first):
                p, t = p_line[x], t_line[x]
                difference = p - t
                total += abs(difference)
                slope = l1_weight if difference > zero else -l1_weight
                slope = slope if difference != zero else zero
                ssim_slope = lines[0, x] + two * p * lines[1, x] + t * lines[2, x]
                slopes[x] = slope - ssim_weight * ssim_slope
        l1_sums[item] = total


@kernel(fastmath=True, parallel=True)
def _correct(picture, gain, bias, rows, starts, bounds, out):  # type: ignore[no-untyped-def]
    channels, count = out.shape[0], rows.shape[0]
    for item in prange(channels * count):
        c, y = item // count, rows[item % count]
        for run in range(starts[y], starts[y + 1]):
            first, end = bounds[run, 0], bounds[run, 1]
            given, corrected = picture[c, y, first:end], out[c, y, first:end]
            for x in range(end - first):
                corrected[x] = gain[c] * given[x] + bias[c]


@kernel(fastmath=True, parallel=True)
def _uncorrect(  # type: ignore[no-untyped-def]
    picture, gradient, gain, rows, starts, bounds, picture_grad, gain_sums, bias_sums
):
    channels, count = gradient.shape[0], rows.shape[0]
    for item in prange(channels * count):
        c, y = item // count, rows[item % count]
        by_gain, by_bias = np.float32(0), np.float32(0)
        for run in range(starts[y], starts[y + 1]):
            first, end = bounds[run, 0], bounds[run, 1]
            given, slopes = picture[c, y, first:end], gradient[c, y, first:end]
            out = picture_grad[c, y, first:end]
            for x in range(end - first):
                g = slopes[x]
                by_gain += g * given[x]
                by_bias += g
                out[x] = gain[c] * g
        gain_sums[item] = by_gain
        bias_sums[item] = by_bias


@kernel(parallel=True)
def _ignore(mask, pred, target, rows, starts, bounds, out_pred, out_target):  # type: ignore[no-untyped-def]
    """Both with IGNORED where the mask ignores, in the runs; out_pred may be pred."""
    channels, count = target.shape[0], rows.shape[0]
    ignored = np.float32(IGNORED)
    for item in prange(channels * count):
        c, y = item // count, rows[item % count]
        for run in range(starts[y], starts[y + 1]):
            first, end = bounds[run, 0], bounds[run, 1]
            counts, p_line, t_line = (
                mask[y, first:end],
                pred[c, y, first:end],
                target[c, y, first:end],
            )
            to_p, to_t = out_pred[c, y, first:end], out_target[c, y, first:end]
            for x in range(end - first):
                to_p[x] = p_line[x] if counts[x] > 0 else ignored
                to_t[x] = t_line[x] if counts[x] > 0 else ignored


@kernel(parallel=True)
def _silence(mask, rows, starts, bounds, gradient):  # type: ignore[no-untyped-def]
    channels, count = gradient.shape[0], rows.shape[0]
    for item in prange(channels * count):
        c, y = item // count, rows[item % count]
        for run in range(starts[y], starts[y + 1]):
            first, end = bounds[run, 0], bounds[run, 1]
            counts, slopes = mask[y, first:end], gradient[c, y, first:end]
            for x in range(end - first):
                slopes[x] = slopes[x] if counts[x] > 0 else np.float32(0)


@dataclass(frozen=True, slots=True)
class Loss:
    """The loss of one picture and its gradients.

    Where only some tiles were compared, the value is a sum over their pixels, still divided by the
    number of all; the gradient is written on those tiles alone; and gain and bias, which act on the
    whole picture, get none.
    """

    value: float
    picture_grad: Floats  # shape of the picture, zero in its padding
    gain_grad: Floats | None  # (3,) float32
    bias_grad: Floats | None  # (3,) float32
    covered: float = 1.0
    """Share of the picture's pixels that the value covers."""


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
        self.whole = Looked.whole(*shape[1:])

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
    active: Flags | None = None,
) -> Loss:
    """Compares gain * picture + bias with `target`.

    picture: (3, >=H, >=W) float32, padded; target: (3, H, W) float32; gain, bias: (3,) float32.
    workspace: of the target's shape, to be reused from call to call; it holds the gradient given.
    mask: (H, W), above 0 where a pixel counts; the others add nothing to the sums and get no
    gradient, and the mean stays over all pixels. None: all count.
    active: (tiles_y, tiles_x) bool, the tiles to compare, see `Loss`; of the picture, only they and
    their eight neighbours need to be there. None: the whole picture.
    """
    channels, height, width = target.shape
    count = channels * height * width
    work = workspace or Workspace(target.shape)
    pred, blurred, partials, gradient = work.pred, work.blurred, work.partials, work.gradient
    looked = work.whole if active is None else Looked.at(active, RADIUS_PX, height, width)
    own = looked.own
    _correct(picture, gain, bias, *looked.picture.arrays, pred)
    if mask is not None:
        given, target = target, work.masked_target_of(target)
        _ignore(mask, pred, given, *looked.picture.arrays, pred, target)
    ssim_sums = np.empty(channels * len(looked.similarity.rows), np.float32)
    l1_sums, gain_sums, bias_sums = (
        np.empty(channels * len(own.rows), np.float32) for _ in range(3)
    )
    _blur_products_rows(pred, target, TAPS, *looked.products.arrays, blurred)
    _ssim_columns(
        blurred,
        TAPS,
        *looked.similarity.arrays,
        own.starts,
        own.bounds,
        active is None,
        partials,
        ssim_sums,
    )
    _blur_rows(partials, TAPS, *looked.partials.arrays, blurred[:3])
    _gradient_columns(
        pred, target, blurred, TAPS,
        np.float32((1 - dssim_weight) / count), np.float32(dssim_weight / count),
        *own.arrays, gradient, l1_sums,
    )  # fmt: skip
    if mask is not None:
        _silence(mask, *own.arrays, gradient)
    picture_grad = work.picture_grad_of(picture)
    _uncorrect(picture, gradient, gain, *own.arrays, picture_grad, gain_sums, bias_sums)
    covered = own.pixels / (height * width)
    l1 = float(l1_sums.sum(dtype=np.float64)) / count
    dssim = covered - float(ssim_sums.sum(dtype=np.float64)) / count
    value = (1 - dssim_weight) * l1 + dssim_weight * dssim
    if active is not None:
        return Loss(value, picture_grad, None, None, covered)
    by_gain, by_bias = (s.reshape(channels, height).sum(axis=1) for s in (gain_sums, bias_sums))
    return Loss(value, picture_grad, by_gain, by_bias)


def ssim(picture: Floats, target: Floats, mask: MaskLike | None = None) -> float:
    """Mean SSIM over pixels and channels; both (H, W, 3) float32 in 0..1.

    mask: (H, W), above 0 where a pixel counts: the mean is over those, and the others look alike
    in both pictures. NaN if none counts.
    """
    pred, goal = (np.ascontiguousarray(p.transpose(2, 0, 1)) for p in (picture, target))
    whole = Runs.whole(*goal.shape[1:])
    if mask is not None:
        given = pred, goal
        pred, goal = np.empty_like(pred), np.empty_like(goal)
        _ignore(mask, *given, *whole.arrays, pred, goal)
    blurred = np.empty((5, *goal.shape), np.float32)
    sums = np.empty(goal.shape[0] * goal.shape[1], np.float32)
    _blur_products_rows(pred, goal, TAPS, *whole.arrays, blurred)
    if mask is not None:
        counts = mask > 0
        return float(_ssim_map(blurred)[:, counts].mean()) if counts.any() else float("nan")
    partials = np.empty((3, *goal.shape), np.float32)
    _ssim_columns(blurred, TAPS, *whole.arrays, whole.starts, whole.bounds, True, partials, sums)
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
