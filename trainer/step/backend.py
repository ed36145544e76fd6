"""Where the pictures of a training step are rendered and differentiated: on the CPU, or on a device
of torch.

A backend is given parameters in host memory and writes gradients to host memory; the optimiser,
noise and relocation are the same for both.
"""

from __future__ import annotations

from typing import Literal, Protocol

import numpy as np
import numpy.typing as npt

from trainer.pictures.shot import Shot

from .loss import Loss, photometric_loss
from .raster import Ints, Parameters, Scratch, View, backward, render
from .target import Targets

Floats = npt.NDArray[np.float32]

BackendName = Literal["auto", "cpu", "cuda", "torch"]


class Backend(Protocol):
    """Renders, compares, differentiates."""

    def step(
        self,
        values: Parameters,
        rows: Ints,
        view: View,
        shot: Shot,
        gain: Floats,
        bias: Floats,
        trainable: int,
        gradients: Parameters,
        whole: bool = True,
    ) -> Loss:
        """The loss of the Gaussians `rows` seen by `view` against `shot`.

        shot: of the view's size; gain, bias: (3,) of its camera. Writes the gradients of those rows
        that are below `trainable` into `gradients`.

        whole: the loss covers all of the picture. Otherwise a backend may leave out what does not
        matter to those gradients, which are the same, and give a loss as of some tiles, see `Loss`.
        """
        ...


class CpuBackend:
    """The numba rasteriser."""

    def __init__(self, dssim_weight: float, opacity_reg: float, scale_reg: float) -> None:
        self._dssim_weight = dssim_weight
        self._opacity_reg, self._scale_reg = opacity_reg, scale_reg
        self._scratch = Scratch()
        self._targets = Targets()

    def step(
        self,
        values: Parameters,
        rows: Ints,
        view: View,
        shot: Shot,
        gain: Floats,
        bias: Floats,
        trainable: int,
        gradients: Parameters,
        whole: bool = True,
    ) -> Loss:
        """See `Backend.step`."""
        target, workspace = self._targets.take(shot)
        rendered = render(values, rows, view, self._scratch, None if whole else trainable)
        loss = photometric_loss(
            rendered.picture, target, self._dssim_weight, gain, bias, workspace, shot.mask,
            rendered.active,
        )  # fmt: skip
        backward(
            rendered, values, loss.picture_grad, trainable, gradients, self._opacity_reg,
            self._scale_reg,
        )  # fmt: skip
        return loss
