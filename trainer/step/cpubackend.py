"""The numba rasteriser and the resident that it computes, whose arrays are the host's; and pictures
as the loss wants them: planar floats, whole or at half the size.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from codec.arrays import Floats, Ints
from trainer.pictures.scale import Shot

from .backend import MemoryNeeds, Resident, Selection, Step, StepInput, Training
from .loss import Loss, Workspace, photometric_loss
from .optimiser import GATE_STEEPNESS, add_noise, bound_scales, move_together
from .raster import Parameters, Scratch, backward, render


class Targets:
    """Converts pictures; keeps one target and one workspace of the loss for every size."""

    def __init__(self) -> None:
        self._held: dict[tuple[int, int], tuple[Floats, Workspace]] = {}

    def take(self, shot: Shot) -> tuple[Floats, Workspace]:
        """The shot's picture as (3, h, w) float32 in 0..1, and the workspace for it. The next call
        of that size reuses both."""
        if shot.shape not in self._held:
            shape = (3, *shot.shape)
            self._held[shot.shape] = np.empty(shape, np.float32), Workspace(shape)
        target, workspace = self._held[shot.shape]
        shot.fill(target)
        return target, workspace


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

    def plan(self, needs: MemoryNeeds) -> str | None:
        """See `Backend.plan`."""
        return None

    def start(self, training: Training) -> Resident:
        """See `Backend.start`."""
        return HostResident(self, training)


class HostResident(Resident):
    """A training whose steps change the host's arrays."""

    def __init__(self, backend: CpuBackend, training: Training) -> None:
        self._backend, self._training = backend, training
        self._gradients = Parameters.zeros_like(training.values, training.num_gs)
        self._ages = np.zeros(training.num_gs, np.float32)
        self._cells: Sequence[Ints] = ()
        self._losses: list[float] = []

    def begin_window(self, ages: Floats, cells: Sequence[Ints]) -> None:
        """See `Resident.begin_window`."""
        self._ages, self._cells = ages, cells

    def step(self, step: Step, selection: Selection) -> None:
        """See `Resident.step`."""
        training, trained = self._training, selection.trained
        values, colour, camera = training.values, training.colour, step.camera
        view, shot = training.views[camera], training.pictures.shot(camera, step.frame)
        if step.is_half:
            view, shot = training.half_views[camera], shot.half()
        given = StepInput(
            values, selection.rows, view, shot, colour.gain(camera), colour.bias(camera),
            training.num_gs, step.whole,
        )  # fmt: skip
        loss = self._backend.step(given, self._gradients)
        if step.level is not None:
            move_together(self._gradients.means, trained, self._cells[step.level])
        training.adam.step(values, self._gradients, trained, step.means_lr_m, self._ages, step.calm)
        if loss.gain_grad is not None and loss.bias_grad is not None:
            colour.step(camera, loss.gain_grad, loss.bias_grad)
        add_noise(
            values.means, values.log_scales, values.quats, values.logit_opacities, trained,
            np.float32(step.noise_m), np.float32(training.dead_opacity),
            np.float32(GATE_STEEPNESS), step.seed,
        )  # fmt: skip
        self._losses.append(loss.value)

    def losses(self, wait: bool) -> list[float]:
        """See `Resident.losses`."""
        known, self._losses = self._losses, []
        return known

    def bound_scales(self, selection: Selection, max_scale: float) -> None:
        """See `Resident.bound_scales`."""
        training = self._training
        bound_scales(training.values, selection.trained, training.spread, max_scale)
