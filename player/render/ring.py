"""The Gaussians of the current window in fixed arrays: swin_size lanes of slices."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from codec.errors import InvalidError
from codec.slice import HIDDEN, Slice, kept_offsets, window_births
from codec.splats import Splats, sh_count

from .lane import check_slice

Rows = npt.NDArray[np.int32] | slice


class Ring:
    """`swin_size` lanes of `slice_size` Gaussians; a slice replaces what its lane held,
    or some rows of it.

    Invariant: lane `birth % swin_size` holds what it shows from the birth put there last on, so
    memory stays the same however many slices come.
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
        lanes = (swin_size, slice_size)
        self._means = np.zeros((*lanes, 3), np.float32)
        self._log_scales = np.zeros((*lanes, 3), np.float32)
        self._quats = np.zeros((*lanes, 4), np.float32)
        self._logit_opacities = np.zeros(lanes, np.float32)
        self._sh = np.zeros((*lanes, sh_count(sh_degree), 3), np.float32)
        self._start_offsets = np.zeros(lanes, np.uint8)
        self._births: list[int | None] = [None] * swin_size

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

    def _write(self, lane: int, rows: Rows, slice: Slice) -> None:
        self._means[lane][rows] = slice.splats.means
        self._log_scales[lane][rows] = slice.splats.log_scales
        self._quats[lane][rows] = slice.splats.quats
        self._logit_opacities[lane][rows] = slice.splats.logit_opacities
        self._sh[lane][rows] = slice.splats.sh
        self._start_offsets[lane][rows] = slice.start_offsets

    def active(self, frame: int) -> Splats:
        """The Gaussians that show at `frame`, oldest slice first."""
        parts = []
        for birth in window_births(frame, self.swin_size):
            lane = birth % self.swin_size
            if self._births[lane] != birth:
                continue
            shown = np.flatnonzero(self._start_offsets[lane] <= frame - birth)
            parts.append(self._take(lane, shown))
        return Splats.concatenate(parts) if parts else Splats.empty(self.sh_degree)

    def _take(self, lane: int, rows: npt.NDArray[np.intp]) -> Splats:
        return Splats(
            self._means[lane, rows],
            self._log_scales[lane, rows],
            self._quats[lane, rows],
            self._logit_opacities[lane, rows],
            self._sh[lane, rows],
        )
