"""The Gaussians that mature together, once per frame."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from .errors import InvalidError
from .splats import Splats

MAX_SWIN_SIZE = 255
"""Frames a Gaussian may live; start offsets are stored in one byte."""

HIDDEN = 255
"""Start offset of a Gaussian that no frame shows, such as one in a slot that ended or is unknown:
a frame lies less than swin_size <= MAX_SWIN_SIZE frames after the birth."""


@dataclass(frozen=True, slots=True)
class Slice:
    """The Gaussians that are due at frame `birth` and gone at `birth + swin_size`.

    A Gaussian shows in frames start <= frame < birth + swin_size, where start = birth +
    start_offset: relocation in training may delay it (Algorithm 1's "birth" and "start").
    """

    birth: int
    splats: Splats
    start_offsets: npt.NDArray[np.uint8]  # (N,) frames after birth
    rows: npt.NDArray[np.int32] | None = None  # (N,) rising, the rows that change; None: whole

    def __post_init__(self) -> None:
        if self.start_offsets.shape != (len(self.splats),):
            raise InvalidError(f"Slice.start_offsets has shape {self.start_offsets.shape}")
        if self.start_offsets.dtype != np.uint8:
            raise InvalidError(f"Slice.start_offsets is {self.start_offsets.dtype}, not uint8")
        rows = self.rows
        if rows is None:
            return
        if rows.shape != (len(self.splats),):
            raise InvalidError(f"Slice.rows has shape {rows.shape}")
        if rows.dtype != np.int32:
            raise InvalidError(f"Slice.rows is {rows.dtype}, not int32")
        if len(rows) and (rows[0] < 0 or (rows[1:] <= rows[:-1]).any()):
            raise InvalidError("Slice.rows does not rise from 0 or more")

    @property
    def num_bytes(self) -> int:
        """What the slice takes in memory."""
        return self.splats.num_bytes + self.start_offsets.nbytes

    def lane(self, swin_size: int) -> int:
        """The lane that this slice takes over."""
        return self.birth % swin_size

    def active(self, frame: int, swin_size: int) -> npt.NDArray[np.bool_]:
        """(N,) which Gaussians show at `frame`."""
        if not self.birth <= frame < self.birth + swin_size:
            return np.zeros(len(self.splats), np.bool_)
        shown: npt.NDArray[np.bool_] = self.start_offsets <= frame - self.birth
        return shown


def window_births(frame: int, swin_size: int) -> range:
    """The births of the slices that show at `frame`, oldest first: any frame can be sought exactly
    by fetching these slices and no other."""
    return range(frame - swin_size + 1, frame + 1)


def active_splats(slices: Iterable[Slice], frame: int, swin_size: int) -> Splats:
    """All Gaussians of `slices` (at least one) that show at `frame`, in the slices' order."""
    return Splats.concatenate(
        [part.splats.take(np.flatnonzero(part.active(frame, swin_size))) for part in slices]
    )
