"""Smaller pictures with their masks; a `Shot` is one camera's picture of one frame.

A pixel of a smaller picture is the mean of the area that it covers, and counts only when all of
that area counts.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from PIL import Image

from codec.arrays import Floats, Longs
from codec.camera import Camera
from codec.kernel import kernel, prange
from trainer.capture.capture import Mask, Picture


def scaled_picture(picture: Picture, camera: Camera) -> Picture:
    """The picture at the size of `camera`, which is at most its own.

    With sides that divide evenly (scale 0.5: 2x2) the mean is over whole pixels, rounded once.
    """
    height_px, width_px = picture.shape[:2]
    if (width_px, height_px) == (camera.width_px, camera.height_px):
        return picture
    image = Image.fromarray(picture)
    if width_px % camera.width_px == 0 and height_px % camera.height_px == 0:
        return np.array(image.reduce((width_px // camera.width_px, height_px // camera.height_px)))
    return np.array(image.resize((camera.width_px, camera.height_px), Image.Resampling.BOX))


def scaled_mask(mask: Mask, width_px: int, height_px: int) -> Mask:
    """The mask of a picture scaled to `width_px` x `height_px`, which is at most its own size."""
    if mask.shape == (height_px, width_px):
        return mask
    # How many ignored pixels are above and to the left.
    ignored = np.zeros((mask.shape[0] + 1, mask.shape[1] + 1), np.int64)
    ignored[1:, 1:] = (mask == 0).cumsum(axis=0).cumsum(axis=1)
    tops, bottoms = _covered(mask.shape[0], height_px)
    lefts, rights = _covered(mask.shape[1], width_px)
    covered = (
        ignored[np.ix_(bottoms, rights)]
        - ignored[np.ix_(tops, rights)]
        - ignored[np.ix_(bottoms, lefts)]
        + ignored[np.ix_(tops, lefts)]
    )
    scaled: Mask = (covered == 0).astype(np.uint8)
    return scaled


def half_mask(mask: Mask) -> Mask:
    """The mask of the picture's 2x2 means; an odd last row or column is left out."""
    even = mask[: mask.shape[0] // 2 * 2, : mask.shape[1] // 2 * 2]
    half: Mask = even[::2, ::2] & even[::2, 1::2] & even[1::2, ::2] & even[1::2, 1::2]
    return half


def _covered(full_px: int, small_px: int) -> tuple[Longs, Longs]:
    """For each small pixel along a side, the full ones that it touches: the first, and the one
    after the last."""
    edges = np.arange(small_px + 1, dtype=np.int64) * full_px
    return edges[:-1] // small_px, -(-edges[1:] // small_px)


@kernel(parallel=True)
def fill_planes(picture, planes):  # type: ignore[no-untyped-def]
    """The picture (H, W, 3) uint8 as planes (3, H, W) float32 in 0..1."""
    height, width, _ = picture.shape
    unit = np.float32(1 / 255)
    for y in prange(height):
        for c in range(3):
            for x in range(width):
                planes[c, y, x] = unit * np.float32(picture[y, x, c])


@kernel(parallel=True)
def fill_half_planes(picture, planes):  # type: ignore[no-untyped-def]
    """The picture's 2x2 means, not rounded, as planes (3, H // 2, W // 2) float32 in 0..1."""
    _, height, width = planes.shape
    unit = np.float32(0.25 / 255)
    for y in prange(height):
        for c in range(3):
            for x in range(width):
                total = np.int32(picture[2 * y, 2 * x, c]) + np.int32(picture[2 * y, 2 * x + 1, c])
                total += np.int32(picture[2 * y + 1, 2 * x, c])
                total += np.int32(picture[2 * y + 1, 2 * x + 1, c])
                planes[c, y, x] = unit * np.float32(total)


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
