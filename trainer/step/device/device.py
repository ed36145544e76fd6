"""A training on a device of torch, around a rasteriser that is given; and how much memory it takes,
before it begins.

Rule: Gaussians, histories, colours and pictures stay on the device. Once the pictures of a window
are there, a step sends its numbers and nothing else; its loss is received with those of the steps
before it.
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from weakref import WeakKeyDictionary

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor

from codec.arrays import Floats, Ints
from codec.errors import InvalidError
from codec.splats import sh_count
from trainer.step.backend import MemoryNeeds, Resident, Selection, Step, StepInput, Training
from trainer.step.loss import Loss
from trainer.step.raster import Parameters

from .tensors import (
    DEFAULT_PICTURE_BYTES,
    Crossing,
    DeviceShot,
    DeviceView,
    PictureCache,
    TensorColour,
    pack,
    unpack,
)
from .tensorstep import (
    Rasterise,
    TensorAdam,
    TensorLoss,
    add_tensor_noise,
    bound_tensor_scales,
    sum_over_cells,
)

PIXEL_BYTES = 1100
"""Of a step for a pixel, most of it in the loss."""

GAUSSIAN_BYTES = 900
"""Of a step for a Gaussian, beside its parameters."""

ROW_COPIES = 9
"""Copies of a Gaussian's parameters in a step: gathered, joined, their gradients, updates."""

TILES_PER_GAUSSIAN = 8
"""Tiles that a Gaussian touches, a generous mean."""

PAIR_BYTES = 120
"""Of a step for a pair of a Gaussian and a tile."""

LEAST_PICTURES = 2
"""Pictures that a step must have room for."""


@dataclass(frozen=True, slots=True)
class MemoryPlan:
    """Bytes on the device."""

    gaussians_bytes: int
    """Parameters and histories."""
    step_bytes: int
    """Memory that a step takes and gives back."""
    pictures_bytes: int
    """The captured pictures that are kept."""

    @property
    def total_bytes(self) -> int:
        return self.gaussians_bytes + self.step_bytes + self.pictures_bytes

    def __str__(self) -> str:
        parts = (
            ("Gaussians", self.gaussians_bytes),
            ("step", self.step_bytes),
            ("pictures", self.pictures_bytes),
        )
        told = ", ".join(f"{name} {num_bytes / 1e9:.2f}" for name, num_bytes in parts)
        return f"{self.total_bytes / 1e9:.2f} GB ({told})"


def planned(
    needs: MemoryNeeds, free_bytes: int, batch_bytes: int, max_picture_bytes: int, where: str
) -> MemoryPlan:
    """The plan of a training on a device with `free_bytes`; pictures get what is left, within
    `max_picture_bytes`.

    batch_bytes: what the rasteriser takes beside pixels and pairs. Raises InvalidError, which
    names `where`, if the device has too little.
    """
    row_bytes = 4 * (11 + 3 * sh_count(needs.sh_degree))
    # Two generations; two histories and the counts of steps.
    gaussians = needs.num_gs * (4 * row_bytes + 4)
    step = needs.num_gs * (ROW_COPIES * row_bytes + GAUSSIAN_BYTES)
    step += needs.num_gs * TILES_PER_GAUSSIAN * PAIR_BYTES
    step += needs.pixels * PIXEL_BYTES + batch_bytes
    shot_bytes = needs.pixels * (4 if needs.has_masks else 3)
    left = free_bytes - gaussians - step
    least = MemoryPlan(gaussians, step, LEAST_PICTURES * shot_bytes)
    if left < least.pictures_bytes:
        raise InvalidError(
            f"{where} has {free_bytes / 1e9:.2f} GB free, and this training needs {least}; choose "
            "a smaller --num-gs, --sh-degree or --scale"
        )
    wanted = min(needs.shots * shot_bytes, max_picture_bytes)
    return MemoryPlan(gaussians, step, max(min(wanted, left), least.pictures_bytes))


def free_bytes(device: torch.device) -> int:
    """Memory of `device` that is not used."""
    if device.type == "cuda":
        return int(torch.cuda.mem_get_info(device)[0])
    if device.type == "xpu":
        return int(torch.xpu.mem_get_info(device)[0])
    if device.type == "mps":
        used: int = torch.mps.driver_allocated_memory()
        return int(torch.mps.recommended_max_memory()) - used
    return _free_host_bytes()


def _free_host_bytes() -> int:
    """On Linux what can be had without swapping; elsewhere all of the memory."""
    try:
        lines = Path("/proc/meminfo").read_text(encoding="ascii").splitlines()
        return 1024 * next(int(n.split()[1]) for n in lines if n.startswith("MemAvailable:"))
    except (OSError, StopIteration, ValueError):
        return os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")


MAX_UNREAD = 256
"""Losses that may wait on the device."""


@dataclass(frozen=True, slots=True, eq=False)
class _Cells:
    """Rows that move together."""

    cells: Tensor  # (num_gs,) int64
    count: int


class DeviceResident(Resident):
    """The steps of a training on a device."""

    def __init__(
        self, training: Training, loss: TensorLoss, crossing: Crossing, picture_bytes: int
    ) -> None:
        """picture_bytes: of captured pictures kept on the device at most."""
        self._training, self._loss, self._crossing = training, loss, crossing
        self._pictures = PictureCache(training.pictures, crossing, picture_bytes)
        self._views = [DeviceView.send(view, crossing) for view in training.views]
        self._half_views = [DeviceView.send(view, crossing) for view in training.half_views]
        self._centre = crossing.send(training.spread.centre)
        self._adam = TensorAdam(training.adam, crossing)
        self._colour = TensorColour(training.colour, crossing)
        self._decay = self._centre.new_ones(training.num_gs)
        self._cells: list[_Cells] = []
        # Of each selection its trained rows (T,) and its others (M - T,), int64.
        self._selected = WeakKeyDictionary[Selection, tuple[Tensor, Tensor]]()
        self._losses: list[Tensor] = []
        self._read: list[float] = []
        # Whether steps have changed what the host has.
        self._is_ahead = self._history_is_ahead = False
        self.send_all()

    def send_all(self) -> None:
        """See `Home.send_all`."""
        training, send = self._training, self._crossing.send
        every = np.arange(len(training.values.means))
        self._values = send(pack(training.values, every))
        self._send_history(every[: training.num_gs])
        self._colour.send(training.colour)
        self._is_ahead = self._history_is_ahead = False

    def send(self, rows: npt.NDArray[np.integer[Any]] | slice) -> None:
        """See `Home.send`."""
        training = self._training
        given = np.arange(len(training.values.means))[rows]
        if not len(given):
            return
        there = self._crossing.send(given)
        packed = self._crossing.send(pack(training.values, given))
        self._values.index_copy_(0, there, packed)
        self._send_history(given[given < training.num_gs])

    def _send_history(self, rows: npt.NDArray[np.integer[Any]]) -> None:
        if not len(rows):
            return
        adam, send, there = self._training.adam, self._crossing.send, self._crossing.send(rows)
        self._adam.first.index_copy_(0, there, send(pack(adam.first, rows)))
        self._adam.second.index_copy_(0, there, send(pack(adam.second, rows)))
        self._adam.steps.index_copy_(0, there, send(adam.steps[rows]))

    def fetch(self, history: bool = False) -> None:
        """See `Home.fetch`. What has matured does not change on the device."""
        training, receive = self._training, self._crossing.receive
        if self._is_ahead:
            unpack(receive(self._values[: training.num_gs]), training.values)
            self._colour.fetch(training.colour)
            self._is_ahead = False
        if history and self._history_is_ahead:
            unpack(receive(self._adam.first), training.adam.first)
            unpack(receive(self._adam.second), training.adam.second)
            training.adam.steps[:] = receive(self._adam.steps)
            self._history_is_ahead = False

    def begin_window(self, ages: Floats, cells: Sequence[Ints]) -> None:
        """See `Resident.begin_window`."""
        self._decay = 1 / (1 + self._crossing.send(ages))
        self._cells = [
            _Cells(self._crossing.send(c.astype(np.int64)), int(c.max(initial=0)) + 1)
            for c in cells
        ]

    def _of(self, selection: Selection) -> tuple[Tensor, Tensor]:
        """The trained rows of `selection`, and its others; they are sent with its first step."""
        if selection not in self._selected:
            send, trained = self._crossing.send, selection.trained
            others = np.setdiff1d(selection.rows, trained, assume_unique=True)
            self._selected[selection] = send(trained).long(), send(others).long()
        return self._selected[selection]

    def step(self, step: Step, selection: Selection) -> None:
        """See `Resident.step`."""
        trained, others = self._of(selection)
        self._crossing.count_numbers(step)
        view = (self._half_views if step.is_half else self._views)[step.camera]
        target, counts = self._pictures.take(step.camera, step.frame).planes(step.is_half)
        leaf = self._values.index_select(0, trained).requires_grad_()
        packed = torch.cat([leaf, self._values.index_select(0, others)])
        correction = self._colour.of(step.camera).requires_grad_()
        compared = self._loss.compare(
            packed, view, target, counts, correction, len(leaf), step.whole
        )
        compared.total.backward()  # type: ignore[no-untyped-call]
        self._losses.append(compared.photometric)
        if len(self._losses) == MAX_UNREAD:
            self._read += self._received_losses()
        with torch.no_grad():
            if leaf.grad is not None:
                self._update(step, trained, leaf, leaf.grad)
            if correction.grad is not None and compared.is_whole:
                self._colour.update(step.camera, correction.grad)
        self._is_ahead = self._history_is_ahead = True

    def _update(self, step: Step, rows: Tensor, leaf: Tensor, gradients: Tensor) -> None:
        if step.level is not None:
            cells = self._cells[step.level]
            sum_over_cells(gradients, rows, cells.cells, cells.count)
        values = leaf.detach()
        decay = self._decay.index_select(0, rows)
        self._adam.update(values, gradients, rows, step.means_lr_m, step.calm, decay)
        add_tensor_noise(values, rows, step.noise_m, self._training.dead_opacity, step.seed)
        self._values.index_copy_(0, rows, values)

    def _received_losses(self) -> list[float]:
        if not self._losses:
            return []
        received = self._crossing.receive(torch.stack(self._losses))
        self._losses.clear()
        return [float(loss) for loss in received]

    def losses(self, wait: bool) -> list[float]:
        """See `Resident.losses`."""
        if wait:
            self._read += self._received_losses()
        known, self._read = self._read, []
        return known

    def bound_scales(self, selection: Selection, max_scale: float) -> None:
        """See `Resident.bound_scales`."""
        radius_m, (trained, _) = self._training.spread.radius_m, self._of(selection)
        bound_tensor_scales(self._values, trained, self._centre, radius_m, max_scale)
        self._is_ahead = True


class DeviceBackend:
    """A rasteriser on a device of torch, and all that surrounds it."""

    def __init__(
        self,
        dssim_weight: float,
        opacity_reg: float,
        scale_reg: float,
        rasterise: Rasterise,
        device: str,
        batch_bytes: int = 0,
        picture_bytes: int = DEFAULT_PICTURE_BYTES,
    ) -> None:
        """device: of torch; batch_bytes: what the rasteriser takes beside pixels and pairs;
        picture_bytes: of the captured pictures that it keeps at most."""
        # In TF32 the variances of SSIM would be differences of rounded numbers.
        torch.backends.cudnn.allow_tf32 = False
        self.crossing = Crossing(torch.device(device))
        """Counts what this backend sends and receives."""
        self.loss = TensorLoss(dssim_weight, opacity_reg, scale_reg, rasterise, self.crossing)
        self._batch_bytes = batch_bytes
        self._picture_bytes = self._max_picture_bytes = picture_bytes

    def plan(self, needs: MemoryNeeds) -> str | None:
        """See `Backend.plan`."""
        device = self.crossing.device
        free, where = free_bytes(device), f"device {device}"
        plan = planned(needs, free, self._batch_bytes, self._max_picture_bytes, where)
        self._picture_bytes = plan.pictures_bytes
        return f"memory: {plan} of {free / 1e9:.1f} GB that are free on {where}"

    def start(self, training: Training) -> Resident:
        """See `Backend.start`."""
        return DeviceResident(training, self.loss, self.crossing, self._picture_bytes)

    def step(self, given: StepInput, gradients: Parameters) -> Loss:
        """See `Backend.step`; computes all of the picture in any case. For trials: a training has
        a resident."""
        crossing, rows, shot = self.crossing, given.rows, given.shot
        leaf = crossing.send(pack(given.values, rows)).requires_grad_()
        correction = crossing.send(np.concatenate([given.gain, given.bias])).requires_grad_()
        mask = None if shot.mask is None else crossing.send_picture(shot.mask) > 0
        sent = DeviceShot(crossing.send_picture(shot.picture), None)
        target, _ = sent.planes(shot.is_half)
        view = DeviceView.send(given.view, crossing)
        compared = self.loss.compare(leaf, view, target, mask, correction, len(leaf), whole=True)
        compared.picture.retain_grad()
        compared.total.backward()  # type: ignore[no-untyped-call]
        found = Parameters.zeros_like(given.values, len(rows))
        unpack(self._received(leaf), found)
        mine = rows < given.trainable
        for gradient, array in zip(gradients.arrays, found.arrays, strict=True):
            gradient[rows[mine]] = array[mine]
        by_correction = self._received(correction)
        return Loss(
            float(crossing.receive(compared.photometric)),
            self._received(compared.picture),
            by_correction[:3],
            by_correction[3:],
        )

    def _received(self, leaf: Tensor) -> np.ndarray:
        """The gradient of `leaf` in host memory; zeros where it had no part."""
        return self.crossing.receive(torch.zeros_like(leaf) if leaf.grad is None else leaf.grad)
