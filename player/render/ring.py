"""The Gaussians of the current window in fixed arrays: swin_size lanes of slices."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from codec.arrays import Ints
from codec.errors import InvalidError
from codec.slice import HIDDEN, Slice, blank_splats, kept_offsets, window_births
from codec.splats import Splats

from .colours import SeenColours
from .lane import check_slice

Rows = npt.NDArray[np.int32] | slice


class Ring:
    """`swin_size` lanes of `slice_size` Gaussians; a slice replaces what its lane held,
    or some rows of it.

    Invariant: lane `birth % swin_size` holds what it shows from the birth put there last on, so
    memory stays the same however many slices come. Behind the lanes lie spare rows for Gaussians
    that fade out, as many as there ever were at once.
    """

    def __init__(self, swin_size: int, slice_size: int, sh_degree: int) -> None:
        if swin_size < 1 or slice_size < 1:
            raise InvalidError(
                f"a ring needs at least one lane of one Gaussian, "
                f"not {swin_size} lanes of {slice_size}"
            )
        self.swin_size = swin_size
        self.slice_size = slice_size
        self.sh_degree = sh_degree
        self.splats = blank_splats(swin_size * slice_size, sh_degree)
        """All lanes, one after another, whether they show or not."""
        self.seen = SeenColours.none_of(len(self.splats), sh_degree)
        """The colours in which they were seen last."""
        self._start_offsets = np.zeros((swin_size, slice_size), np.uint8)
        self._births: list[int | None] = [None] * swin_size
        self._num_leaving = 0

    def put(self, slice: Slice) -> None:
        """Copies `slice` into its lane, in place of what was there in the rows that it changes."""
        check_slice(slice, self.slice_size, self.sh_degree)
        lane, rows = slice.lane(self.swin_size), slice.rows
        slice.check_follows(self._births[lane], self.swin_size)
        offsets = self._start_offsets[lane]
        if rows is None:
            offsets[:] = HIDDEN
            self._write(lane, np.s_[: len(slice.splats)], slice)
        else:
            offsets[:] = kept_offsets(offsets)
            self._write(lane, rows, slice)
        self._births[lane] = slice.birth

    def correct(self, slice: Slice) -> None:
        """Copies the rows of `slice` into its lane, if that still has the slice that it corrects;
        all other rows stay."""
        lane = slice.lane(self.swin_size)
        if slice.rows is not None and slice.corrects(self._births[lane]):
            self._write(lane, slice.rows, slice)

    def put_leaving(self, leaving: Splats) -> None:
        """Shows `leaving` in every frame, in place of those put here before."""
        first, count = self.swin_size * self.slice_size, len(leaving)
        if first + count > len(self.splats):
            lanes = self.splats.take(slice(first))
            self.splats = Splats.concatenate([lanes, blank_splats(count, self.sh_degree)])
            self.seen = SeenColours.none_of(len(self.splats), self.sh_degree)
        for array, changed in zip(self.splats.arrays, leaving.arrays, strict=True):
            array[first : first + count] = changed
        self.seen.forget(first, first + count, slice(None))
        self._num_leaving = count

    def _write(self, lane: int, rows: Rows, slice: Slice) -> None:
        first = lane * self.slice_size
        for array, changed in zip(self.splats.arrays, slice.splats.arrays, strict=True):
            array[first : first + self.slice_size][rows] = changed
        self._start_offsets[lane][rows] = slice.start_offsets
        self.seen.forget(first, first + self.slice_size, rows)

    def active_rows(self, frame: int) -> Ints:
        """(M,) int32: the rows of `splats` that show at `frame`, oldest slice first."""
        spare = self.swin_size * self.slice_size
        parts = [np.arange(spare, spare + self._num_leaving, dtype=np.int32)]
        for birth in window_births(frame, self.swin_size):
            lane = birth % self.swin_size
            if self._births[lane] != birth:
                continue
            shown = np.flatnonzero(self._start_offsets[lane] <= frame - birth)
            parts.append((shown + lane * self.slice_size).astype(np.int32))
        return np.concatenate(parts)

    def active(self, frame: int) -> Splats:
        """The Gaussians that show at `frame`, oldest slice first."""
        return self.splats.take(self.active_rows(frame))
