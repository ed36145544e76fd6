"""The only place where arrays cross between host memory and a device of torch; it counts bytes."""

from __future__ import annotations

from dataclasses import fields
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor

from codec.arrays import Bytes

if TYPE_CHECKING:
    from _typeshed import DataclassInstance

PINNED_BYTES = 1 << 16
"""Size from which on memory is pinned, so that the host does not wait for the copy."""

NUMBER_BYTES = 8
"""Size of a number that a step is called with."""


class Crossing:
    """Copies to a device and back."""

    def __init__(self, device: torch.device) -> None:
        self.device = device
        self.sent_bytes = 0
        """Bytes of arrays and numbers, pictures apart."""
        self.picture_bytes = 0
        """Bytes of pictures and masks."""
        self.received_bytes = 0

    @property
    def crossed_bytes(self) -> int:
        """Bytes in both directions, pictures apart."""
        return self.sent_bytes + self.received_bytes

    def _copied(self, array: npt.NDArray[Any]) -> Tensor:
        # Copied on a CPU, where the tensor would be the caller's array.
        there = torch.from_numpy(np.array(array, order="C"))
        if self.device.type == "cuda" and array.nbytes >= PINNED_BYTES:
            return there.pin_memory().to(self.device, non_blocking=True)
        return there.to(self.device)

    def send(self, array: npt.NDArray[Any]) -> Tensor:
        """A copy of `array` on the device, of the same type; float64 becomes float32, which not
        every device has."""
        given = array.astype(np.float32) if array.dtype == np.float64 else array
        self.sent_bytes += given.nbytes
        return self._copied(given)

    def send_picture(self, array: Bytes) -> Tensor:
        """A copy of a picture or a mask on the device."""
        self.picture_bytes += array.nbytes
        return self._copied(array)

    def count_numbers(self, numbers: DataclassInstance) -> None:
        """Counts numbers that operations are called with."""
        self.sent_bytes += NUMBER_BYTES * len(fields(numbers))

    def receive(self, tensor: Tensor) -> npt.NDArray[Any]:
        """A copy of `tensor` in host memory; waits for what computes it."""
        self.received_bytes += tensor.numel() * tensor.element_size()
        received: npt.NDArray[Any] = tensor.detach().cpu().numpy()
        return received.copy() if self.device.type == "cpu" else received
