"""Tensors of a training on a device: rows of parameters, cameras, pictures, colours.

Rule: arrays cross between host memory and a device of torch here and nowhere else; the bytes are
counted. A camera is sent once, a picture as bytes when first asked for, and kept within a bound.
Parameters are one tensor, a row for each Gaussian, so that a step gathers and writes rows once.
"""

from __future__ import annotations

import math
from collections import OrderedDict
from dataclasses import dataclass, fields
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor

from codec.arrays import Bytes, Floats
from codec.camera import Camera
from trainer.pictures.framecache import Pictures
from trainer.pictures.scale import Shot
from trainer.step.colour import EPS, FULL_STEPS, IDENTITY, LEAST_SHARE, PULL, CameraColour
from trainer.step.optimiser import BETA1, BETA2
from trainer.step.raster import Parameters, View

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


MEANS = slice(0, 3)
LOG_SCALES = slice(3, 6)
QUATS = slice(6, 10)
LOGIT_OPACITY = 10
SH = slice(11, None)

COLUMNS = (MEANS, LOG_SCALES, QUATS, slice(LOGIT_OPACITY, LOGIT_OPACITY + 1), SH)
"""In the order of `Parameters.arrays`."""


def pack(parameters: Parameters, rows: npt.NDArray[np.integer]) -> Floats:
    """(M, D) float32: the rows of `parameters`."""
    arrays = parameters.arrays
    parts = [array[rows].reshape(len(rows), math.prod(array.shape[1:])) for array in arrays]
    packed: Floats = np.concatenate(parts, axis=1)
    return packed


def unpack(packed: Floats, parameters: Parameters) -> None:
    """Writes (M, D) into the first M rows of `parameters`."""
    for array, columns in zip(parameters.arrays, COLUMNS, strict=True):
        array[: len(packed)] = packed[:, columns].reshape(len(packed), *array.shape[1:])


def parts_of(packed: Tensor) -> tuple[Tensor, Tensor, Tensor, Tensor, Tensor]:
    """Views of (M, D): means (M, 3), log_scales (M, 3), quats (M, 4), logit_opacities (M,) and sh
    (M, K, 3)."""
    return (
        packed[:, MEANS],
        packed[:, LOG_SCALES],
        packed[:, QUATS],
        packed[:, LOGIT_OPACITY],
        packed[:, SH].reshape(len(packed), (packed.shape[1] - SH.start) // 3, 3),
    )


@dataclass(frozen=True, slots=True, eq=False)
class DeviceView:
    """A `View` with its matrices on the device."""

    camera: Camera
    near_m: float
    tiles_x: int
    tiles_y: int
    w2c: Tensor  # (4, 4) float32, world to camera
    intrinsics: Tensor  # (3, 3) float32
    position: Tensor  # (3,) float32, metres, world
    tiles: Tensor  # (2,) float32: tiles_x and tiles_y

    @staticmethod
    def send(view: View, crossing: Crossing) -> DeviceView:
        camera = view.camera
        tiles = np.array([view.tiles_x, view.tiles_y])
        given = camera.w2c, camera.intrinsics, camera.position, tiles
        sent = (crossing.send(np.asarray(array, np.float32)) for array in given)
        return DeviceView(camera, view.near_m, view.tiles_x, view.tiles_y, *sent)


DEFAULT_PICTURE_BYTES = 4 << 30
"""Bytes of pictures kept on a device: 36 cameras x 27 frames at 1352x1014."""


@dataclass(frozen=True, slots=True, eq=False)
class DeviceShot:
    """A picture with its mask, of the full size."""

    picture: Tensor  # (H, W, 3) uint8 RGB
    mask: Tensor | None  # (H, W) uint8: above 0 where a pixel counts; None if all do

    @property
    def num_bytes(self) -> int:
        return self.picture.numel() + (0 if self.mask is None else self.mask.numel())

    def planes(self, is_half: bool) -> tuple[Tensor, Tensor | None]:
        """(3, h, w) float32 in 0..1; and (h, w) bool where a pixel counts."""
        planes = self.picture.permute(2, 0, 1).float() / 255
        counts = None if self.mask is None else self.mask > 0
        if is_half:
            planes = torch.nn.functional.avg_pool2d(planes, 2)
            counts = None if counts is None else _halved(counts)
        return planes, counts


def _halved(counts: Tensor) -> Tensor:
    """As trainer.pictures.scale.half_mask."""
    even = counts[: counts.shape[0] // 2 * 2, : counts.shape[1] // 2 * 2]
    return even[::2, ::2] & even[::2, 1::2] & even[1::2, ::2] & even[1::2, 1::2]


class PictureCache:
    """Shots of a training on a device. When full, the least recently used goes; to ask for it
    again sends it again."""

    def __init__(self, pictures: Pictures, crossing: Crossing, max_bytes: int) -> None:
        self._pictures, self._crossing, self._max_bytes = pictures, crossing, max_bytes
        self._held: OrderedDict[tuple[int, int], DeviceShot] = OrderedDict()
        self.held_bytes = 0

    def take(self, camera: int, frame: int) -> DeviceShot:
        """The shot of a camera at a frame. Raises CaptureError when it cannot be read."""
        key = camera, frame
        if key in self._held:
            self._held.move_to_end(key)
            return self._held[key]
        sent = self._sent(self._pictures.shot(camera, frame))
        while self._held and self.held_bytes + sent.num_bytes > self._max_bytes:
            self.held_bytes -= self._held.popitem(last=False)[1].num_bytes
        self._held[key] = sent
        self.held_bytes += sent.num_bytes
        return sent

    def _sent(self, shot: Shot) -> DeviceShot:
        mask = None if shot.mask is None else self._crossing.send_picture(shot.mask)
        return DeviceShot(self._crossing.send_picture(shot.picture), mask)


class TensorColour:
    """Gain and bias of every camera on a device, with their own Adam."""

    def __init__(self, colour: CameraColour, crossing: Crossing) -> None:
        self._crossing, self._lr = crossing, colour.lr
        self._identity = crossing.send(IDENTITY)
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
        step += PULL * (self._values[camera] - self._identity)
        rate = self._lr * (FULL_STEPS / steps).clamp(LEAST_SHARE, 1)
        self._values[camera] -= rate * step
        self._values -= self._values.mean(0) - self._identity
