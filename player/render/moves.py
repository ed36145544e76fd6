"""The kind of motion of each Gaussian that a slice changes, for renderers that mix on the GPU."""

from __future__ import annotations

import numpy as np

from codec.arrays import Ints
from codec.slice import Slice

MOVES, ENTERS, LEAVES = 1, 2, 3
"""Kinds of motion: a slot moves from its previous place; a Gaussian fades in; the slot's previous
Gaussian fades out."""

LEAVING_AT = 8
"""First bit of the number of the spare slot, from 1, in which the previous Gaussian fades out."""

LEAST_SPARE, SPARE_SHARE = 64, 16
"""Gaussians that can fade out at once: the least number, and the part of a lane. In a trained
stream 1 to 2 % of a lane do; what is more vanishes at once."""


def spare_slots(slice_size: int) -> int:
    """Slots behind those of the lanes, for Gaussians that fade out."""
    return min(slice_size, max(LEAST_SPARE, slice_size // SPARE_SHARE))


def moves_of(slice: Slice, num_spare: int) -> Ints | None:
    """(N,) for each of the slice's rows MOVES, ENTERS or 0, and from the bit LEAVING_AT on the
    spare slot of the one before it; None where its motion is not known."""
    rows, motion = slice.rows, slice.motion
    if rows is None or motion is None:
        return None
    moves = np.zeros(len(rows), np.int32)
    moves[np.searchsorted(rows, motion.rows)] = np.where(motion.enters, ENTERS, MOVES)
    left = motion.left[:num_spare]
    moves[np.searchsorted(rows, left)] |= np.arange(1, len(left) + 1, dtype=np.int32) << LEAVING_AT
    return moves
