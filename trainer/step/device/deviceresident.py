"""A training on a device of torch: Gaussians, histories, colours and pictures stay there.

A step sends its numbers and nothing else, once the pictures of a window are there; its loss is
received with those of the steps before it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any
from weakref import WeakKeyDictionary

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor

from codec.arrays import Floats, Ints
from trainer.step.backend import Resident, Selection, Step, Training

from .crossing import Crossing
from .deviceview import DeviceView
from .packedrows import pack, unpack
from .picturecache import PictureCache
from .tensorcolour import TensorColour
from .tensorloss import TensorLoss
from .tensorupdate import TensorAdam, add_tensor_noise, bound_tensor_scales, sum_over_cells

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
