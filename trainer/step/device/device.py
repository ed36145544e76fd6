"""A training step on a device of torch: a rasteriser that is given, and all that surrounds it.

Colours, loss and regularisers are computed here; the optimiser stays on the host.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor

from codec.camera import Camera
from codec.splats import SH_C0
from player.render.recipe import SH_C1, SH_C2, SH_C3
from trainer.pictures.shot import Shot
from trainer.step.backend import StepInput
from trainer.step.loss import C1, C2, IGNORED, RADIUS_PX, TAPS, Loss
from trainer.step.raster import Parameters, View

from .torchproject import Solids

Floats = npt.NDArray[np.float32]

Rasterise = Callable[[Solids, Camera, float], Tensor]
"""Gaussians, a camera and the near plane in metres give a picture (3, H, W), differentiable."""


def _blurred(planes: Tensor, taps: Tensor) -> Tensor:
    """(M, 3, H, W), blurred by the window of SSIM, zero beyond the border."""
    rows = taps.reshape(1, 1, 1, -1).expand(3, 1, 1, -1)
    columns = taps.reshape(1, 1, -1, 1).expand(3, 1, -1, 1)
    planes = torch.nn.functional.conv2d(planes, rows, padding=(0, RADIUS_PX), groups=3)
    blurred: Tensor = torch.nn.functional.conv2d(planes, columns, padding=(RADIUS_PX, 0), groups=3)
    return blurred


def _dissimilarity(pred: Tensor, target: Tensor, taps: Tensor) -> Tensor:
    """1 - mean SSIM of two (3, H, W) pictures."""
    products = [pred, target, pred * pred, target * target, pred * target]
    mu_p, mu_t, pp, tt, pt = _blurred(torch.stack(products), taps)
    var_p, var_t, cov = pp - mu_p**2, tt - mu_t**2, pt - mu_p * mu_t
    ssim = ((2 * mu_p * mu_t + C1) * (2 * cov + C2)) / (
        (mu_p**2 + mu_t**2 + C1) * (var_p + var_t + C2)
    )
    dissimilarity: Tensor = 1 - ssim.mean()
    return dissimilarity


def _colours(means: Tensor, sh: Tensor, position: Tensor) -> Tensor:
    """(N, 3) of recipe v1, of any SH degree."""
    colours = 0.5 + SH_C0 * sh[:, 0]
    if sh.shape[1] >= 4:
        x, y, z = torch.nn.functional.normalize(means - position, dim=1).unsqueeze(-1).unbind(1)
        colours = colours + SH_C1 * (z * sh[:, 2] - y * sh[:, 1] - x * sh[:, 3])
    if sh.shape[1] >= 9:
        higher = torch.cat(_higher_harmonics(x, y, z)[: sh.shape[1] - 4], 1)
        colours = colours + (higher[:, :, None] * sh[:, 4:]).sum(1)
    return colours.clamp(min=0)


def _higher_harmonics(x: Tensor, y: Tensor, z: Tensor) -> list[Tensor]:
    """(N, 1) each of degree 2 and 3, of unit vectors; see player.render.colours."""
    xx, yy, zz = x * x, y * y, z * z
    return [
        SH_C2[0] * x * y,
        -SH_C2[0] * y * z,
        SH_C2[1] * (2 * zz - xx - yy),
        -SH_C2[0] * x * z,
        SH_C2[2] * (xx - yy),
        -SH_C3[0] * y * (3 * xx - yy),
        SH_C3[1] * x * y * z,
        -SH_C3[2] * y * (4 * zz - xx - yy),
        SH_C3[3] * z * (2 * zz - 3 * xx - 3 * yy),
        -SH_C3[2] * x * (4 * zz - xx - yy),
        SH_C3[4] * z * (xx - yy),
        -SH_C3[0] * x * (xx - 3 * yy),
    ]


class DeviceBackend:
    """Uploads the rows of a step, downloads their gradients."""

    def __init__(
        self,
        dssim_weight: float,
        opacity_reg: float,
        scale_reg: float,
        rasterise: Rasterise,
        device: str,
    ) -> None:
        """device: of torch."""
        self._dssim_weight = dssim_weight
        self._opacity_reg, self._scale_reg = opacity_reg, scale_reg
        self._rasterise, self._device = rasterise, torch.device(device)
        self._taps = torch.from_numpy(TAPS.copy()).to(self._device)

    def _sent(self, array: npt.NDArray[Any]) -> Tensor:
        # Copied, because torch warns of what cannot be written to.
        return torch.from_numpy(np.array(array, np.float32, order="C")).to(self._device)

    def step(self, given: StepInput, gradients: Parameters) -> Loss:
        """See `Backend.step`; computes all of the picture in any case."""
        rows, shot = given.rows, given.shot
        leaves = [self._sent(array[rows]).requires_grad_() for array in given.values.arrays]
        correction = [self._sent(c).requires_grad_() for c in (given.gain, given.bias)]
        rendered = self.render(leaves, given.view)
        rendered.retain_grad()
        pred = correction[0][:, None, None] * rendered + correction[1][:, None, None]
        target = self._target(shot)
        if shot.mask is not None:
            counts, grey = self._sent(shot.mask) > 0, pred.new_tensor(IGNORED)
            pred, target = torch.where(counts, pred, grey), torch.where(counts, target, grey)
        l1 = (pred - target).abs().mean()
        dssim = _dissimilarity(pred, target, self._taps)
        photometric = (1 - self._dssim_weight) * l1 + self._dssim_weight * dssim
        _, log_scales, _, logits, _ = leaves
        count = max(len(rows), 1)
        regularisers = (
            self._opacity_reg / count * torch.sigmoid(logits).sum()
            + self._scale_reg / (3 * count) * log_scales.exp().sum()
        )
        (photometric + regularisers).backward()  # type: ignore[no-untyped-call]
        mine = rows < given.trainable
        for gradient, leaf in zip(gradients.arrays, leaves, strict=True):
            gradient[rows[mine]] = _received(leaf)[mine]
        picture_grad = _received(rendered)
        gain_grad, bias_grad = (_received(c) for c in correction)
        return Loss(float(photometric.detach()), picture_grad, gain_grad, bias_grad)

    def render(self, leaves: list[Tensor], view: View) -> Tensor:
        """(3, H, W) of means, log_scales, quats, logit_opacities, sh as `view` sees them."""
        camera = view.camera
        means, log_scales, quats, logits, sh = leaves
        solids = Solids(
            means,
            torch.nn.functional.normalize(quats, dim=1),
            log_scales.exp(),
            torch.sigmoid(logits),
            _colours(means, sh, self._sent(camera.position)),
        )
        return self._rasterise(solids, camera, view.near_m)

    def _target(self, shot: Shot) -> Tensor:
        """(3, h, w) in 0..1: the shot's picture. Sent as bytes, a quarter of the floats."""
        pixels = torch.from_numpy(shot.picture.copy()).to(self._device)
        planes = pixels.permute(2, 0, 1).float() / 255
        return torch.nn.functional.avg_pool2d(planes, 2) if shot.is_half else planes


def _received(leaf: Tensor) -> Floats:
    """The gradient of `leaf` in host memory; zeros where it had no part."""
    if leaf.grad is None:
        return np.zeros(tuple(leaf.shape), np.float32)
    received: Floats = leaf.grad.cpu().numpy()
    return received
