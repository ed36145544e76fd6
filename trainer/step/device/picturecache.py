"""The captured pictures on a device: sent as bytes when first asked for, kept within a bound."""

from __future__ import annotations

from collections import OrderedDict
from dataclasses import dataclass

import torch
from torch import Tensor

from trainer.pictures.feed import Pictures
from trainer.pictures.shot import Shot

from .crossing import Crossing

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
