"""Which pixels of a capture move, and what a stream is worth on them alone.

In most captures almost all pixels stand still, so that a stream may score well and still blur all
that anyone looks at.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from codec.arrays import Flags, Floats
from trainer.pictures.shot import Shot
from trainer.step.loss import psnr_db

MOVING = 12 / 255
"""Change from the frame before, in any channel of a pixel's 3x3 mean, above which it moves. The
mean leaves out most of a sensor's noise."""

MIN_MOVING_PX = 100
"""Fewer moving pixels than these give a picture no score: it would hang on single pixels."""


@dataclass(frozen=True, slots=True, eq=False)
class Movement:
    """The pixels of one camera that have changed since the frame before."""

    pixels: Flags  # (H, W): those that move
    counting: int
    """Pixels that count in both frames."""

    @property
    def moving(self) -> int:
        return int(self.pixels.sum())

    def busiest(self, height_px: int, width_px: int) -> tuple[slice, slice] | None:
        """Rows and columns of the box of that size with most moving pixels, in the middle of those
        that have as many; None where fewer than MIN_MOVING_PX move. The box fits into the
        picture."""
        if self.moving < MIN_MOVING_PX:
            return None
        sums = np.pad(self.pixels.cumsum(axis=0).cumsum(axis=1), ((1, 0), (1, 0)))
        inside = (
            sums[height_px:, width_px:] - sums[:-height_px, width_px:]
            - sums[height_px:, :-width_px] + sums[:-height_px, :-width_px]
        )  # fmt: skip
        best = np.argwhere(inside == inside.max())
        top, left = best[len(best) // 2]
        return slice(top, top + height_px), slice(left, left + width_px)

    def psnr_db(self, shown: Floats, truth: Floats) -> float | None:
        """PSNR over the pixels that move; None where fewer than MIN_MOVING_PX do."""
        return psnr_db(shown, truth, self.pixels) if self.moving >= MIN_MOVING_PX else None


def movement_of(before: Shot, now: Shot) -> Movement:
    """Compares two frames of one camera; both shots of the full size.

    Pixels that a mask ignores in either frame do not move, and are left out of their neighbours'
    means. Beyond the border lies the nearest pixel.
    """
    counts = np.ones(now.shape, np.int16)
    for shot in (before, now):
        if shot.mask is not None:
            counts[shot.mask == 0] = 0
    # Whole numbers, so that a change of MOVING itself is not above it by rounding.
    change = (now.picture.astype(np.int16) - before.picture) * counts[..., None]
    mean = np.abs(_sum_3x3(change)).max(axis=2) / np.maximum(_sum_3x3(counts), 1)
    return Movement((mean / 255 > MOVING) & (counts > 0), int(counts.sum()))


def _sum_3x3(values: npt.NDArray[np.int16]) -> npt.NDArray[np.int16]:
    """Sums over each pixel and its eight neighbours; values: (H, W) or (H, W, C)."""
    beyond = [(1, 1), (1, 1), (0, 0)][: values.ndim]
    padded = np.pad(values, beyond, mode="edge")
    lines = padded[:-2] + padded[1:-1] + padded[2:]
    sums: npt.NDArray[np.int16] = lines[:, :-2] + lines[:, 1:-1] + lines[:, 2:]
    return sums
