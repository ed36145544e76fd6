"""One camera's picture of one frame, and which of its pixels count."""

from __future__ import annotations

from dataclasses import dataclass

from codec.arrays import Floats
from trainer.capture.capture import Mask, Picture

from .scale import fill_half_planes, fill_planes, half_mask


@dataclass(frozen=True, slots=True, eq=False)
class Shot:
    """A picture with its mask, at the full size or at half of it.

    A half shot refers to the same full picture: the means of its 2x2 pixels are not whole numbers,
    so they are taken where floats are wanted, see `fill`.
    """

    picture: Picture  # (H, W, 3) uint8 RGB, always of the full size
    mask: Mask | None = None  # (h, w) of the shot's size: 1 where a pixel counts; None if all do
    is_half: bool = False

    @property
    def shape(self) -> tuple[int, int]:
        """Height and width of the shot, in pixels; an odd last row or column has no half."""
        height, width = self.picture.shape[:2]
        return (height // 2, width // 2) if self.is_half else (height, width)

    def half(self) -> Shot:
        """This shot, which has the full size, at half of it."""
        return Shot(self.picture, None if self.mask is None else half_mask(self.mask), True)

    def fill(self, planes: Floats) -> None:
        """Writes the picture to `planes` (3, h, w), in 0..1."""
        (fill_half_planes if self.is_half else fill_planes)(self.picture, planes)
