"""Masks of smaller pictures: a pixel counts only when all that it covers counts."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from trainer.capture.capture import Mask


def scaled_mask(mask: Mask, width_px: int, height_px: int) -> Mask:
    """The (H, W) mask of a picture scaled to `width_px` x `height_px`, at most its size."""
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
    """The (H, W) mask of the picture's 2x2 means; an odd last row or column is left out."""
    even = mask[: mask.shape[0] // 2 * 2, : mask.shape[1] // 2 * 2]
    half: Mask = even[::2, ::2] & even[::2, 1::2] & even[1::2, ::2] & even[1::2, 1::2]
    return half


def _covered(full_px: int, small_px: int) -> tuple[npt.NDArray[np.int64], npt.NDArray[np.int64]]:
    """For each small pixel along a side, the full ones that it touches: the first, and the one
    after the last."""
    edges = np.arange(small_px + 1, dtype=np.int64) * full_px
    return edges[:-1] // small_px, -(-edges[1:] // small_px)
