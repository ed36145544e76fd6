"""Slices as the buffer of OpenGL 4.3 takes them: the Gaussians that change, and no other."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from codec.arrays import Floats, Ints
from codec.slice import Slice

from ..moves import moves_of
from ..pack import pack_slice, texels_per_gaussian


@dataclass(frozen=True, slots=True)
class PackedRows:
    """A slice as its lane takes it.

    The last two words of a Gaussian, as int32, are its first frame and the slice's `serial`. What
    is kept has an older one, and what a shorter slice left behind it one that is older still.
    """

    lane: int
    serial: int  # rises from slice to slice, from 1 on
    birth: int
    rows: Ints | None  # (N,) rising, those of the lane that change; None: the lane is replaced
    words: Floats  # (N, 4 * texels); see texels_per_gaussian
    moves: Ints | None  # see moves_of


class RowPacker:
    """Packs slices; belongs to the thread that puts."""

    def __init__(self, swin_size: int, sh_degree: int, num_spare: int) -> None:
        """num_spare: slots for Gaussians that fade out."""
        self._swin_size, self._num_spare = swin_size, num_spare
        self._num_words = 4 * texels_per_gaussian(sh_degree)
        self._births: list[int | None] = [None] * swin_size
        self._serial = 0

    def pack(self, slice: Slice) -> PackedRows:
        """The slice, which fits a lane. Raises InvalidError if it changes what its lane lacks."""
        lane = slice.lane(self._swin_size)
        slice.check_follows(self._births[lane], self._swin_size)
        self._births[lane] = slice.birth
        self._serial += 1
        return self._packed(lane, slice)

    def _packed(self, lane: int, slice: Slice) -> PackedRows:
        words = np.zeros((len(slice.splats), self._num_words), np.float32)
        starts = np.empty(len(words), np.int32)
        pack_slice(slice, words, starts)
        times = words.view(np.int32)[:, -2:]
        times[:, 0], times[:, 1] = starts, self._serial
        moves = moves_of(slice, self._num_spare)
        return PackedRows(lane, self._serial, slice.birth, slice.rows, words, moves)

    def forget(self, lane: int) -> None:
        """Packed slices of `lane` may never be uploaded: only a whole slice can follow."""
        self._births[lane] = None
