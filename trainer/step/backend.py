"""Where the pictures of a training step are rendered and differentiated: on the CPU, or on a device
of torch.

A backend is given parameters in host memory and writes gradients to host memory; the optimiser,
noise and relocation are the same for both.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, Protocol

import numpy as np
import numpy.typing as npt

from trainer.pictures.shot import Shot

from .loss import Loss, photometric_loss
from .raster import Ints, Parameters, Scratch, View, backward, render
from .target import Targets

Floats = npt.NDArray[np.float32]

BackendName = Literal["auto", "cpu", "cuda", "torch"]


@dataclass(frozen=True, slots=True)
class StepInput:
    """The input of one training step: what it renders, and compares with."""

    values: Parameters
    rows: Ints
    """Indices of the Gaussians that are rendered."""
    view: View
    shot: Shot
    """The captured picture, of the view's size."""
    gain: Floats
    """(3,) factors of the camera's colours."""
    bias: Floats
    """(3,) added to the camera's colours."""
    trainable: int
    """Rows below this one get gradients."""
    whole: bool = True
    """Whether the loss covers all of the picture. Otherwise a backend may leave out what does not
    matter to the gradients, which are the same, and give a loss as of some tiles, see `Loss`."""


class Backend(Protocol):
    """Renders, compares, differentiates."""

    def step(self, given: StepInput, gradients: Parameters) -> Loss:
        """The loss of a step. Writes the gradients of the trainable rows into `gradients`."""


class CpuBackend:
    """The numba rasteriser."""

    def __init__(self, dssim_weight: float, opacity_reg: float, scale_reg: float) -> None:
        self._dssim_weight = dssim_weight
        self._opacity_reg, self._scale_reg = opacity_reg, scale_reg
        self._scratch = Scratch()
        self._targets = Targets()

    def step(self, given: StepInput, gradients: Parameters) -> Loss:
        """See `Backend.step`."""
        target, workspace = self._targets.take(given.shot)
        active = None if given.whole else given.trainable
        rendered = render(given.values, given.rows, given.view, self._scratch, active)
        loss = photometric_loss(
            rendered.picture, target, self._dssim_weight, given.gain, given.bias, workspace,
            given.shot.mask, rendered.active,
        )  # fmt: skip
        backward(
            rendered, given.values, loss.picture_grad, given.trainable, gradients,
            self._opacity_reg, self._scale_reg,
        )  # fmt: skip
        return loss
