"""Per-camera colour in tensors; see trainer.step.colour."""

from __future__ import annotations

from torch import Tensor

from trainer.step.colour import EPS, CameraColour
from trainer.step.optimiser import BETA1, BETA2

from .crossing import Crossing


class TensorColour:
    """Gain and bias of every camera on a device, with their own Adam."""

    def __init__(self, colour: CameraColour, crossing: Crossing) -> None:
        self._crossing, self._lr = crossing, colour.lr
        self.send(colour)

    def send(self, colour: CameraColour) -> None:
        """Takes over the host's values."""
        arrays = colour.state().values()
        self._values, self._first, self._second, self._steps = map(self._crossing.send, arrays)

    def fetch(self, colour: CameraColour) -> None:
        """Brings the host's values up to date."""
        tensors = self._values, self._first, self._second, self._steps
        for array, tensor in zip(colour.state().values(), tensors, strict=True):
            array[:] = self._crossing.receive(tensor)

    def of(self, camera: int) -> Tensor:
        """(6,) a copy of a camera's gain and bias."""
        return self._values[camera].clone()

    def update(self, camera: int, gradient: Tensor) -> None:
        """One update of a camera's correction by the gradient (6,) of the loss."""
        if self._lr == 0:
            return
        steps, first, second = self._steps[camera], self._first[camera], self._second[camera]
        steps += 1
        first += (1 - BETA1) * (gradient - first)
        second += (1 - BETA2) * (gradient.square() - second)
        step = first / (1 - BETA1**steps) / ((second / (1 - BETA2**steps)).sqrt() + EPS)
        self._values[camera] -= self._lr * step
        mean = self._values.mean(0)
        mean[:3] -= 1
        self._values -= mean
