"""The Gaussians that a lane gets once per frame: all of them, or only those that change."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from codec.arrays import Bytes, Flags, Ints

from .errors import InvalidError
from .halfway import Motion
from .splats import Splats, array_shapes

MAX_SWIN_SIZE = 255
"""Frames a Gaussian may live; start offsets are stored in one byte."""

HIDDEN = 255
"""Start offset of a Gaussian that no frame shows, such as one in a slot that ended or is unknown:
a frame lies less than swin_size <= MAX_SWIN_SIZE frames after the birth."""


@dataclass(frozen=True, slots=True)
class Slice:
    """The Gaussians that are due at frame `birth` and gone at `birth + swin_size`.

    A Gaussian shows in frames start <= frame < birth + swin_size, where start = birth +
    start_offset: relocation in training may delay it (Algorithm 1's "birth" and "start"). One of
    offset HIDDEN never shows; its values mean nothing.

    A slice without `rows` is whole: it replaces all that its lane held. One with `rows` changes
    these rows of its lane and no other. It follows the slice born `swin_size` frames earlier, whose
    other Gaussians go on for `swin_size` frames: the hidden ones hidden, the rest shown from
    `birth` on.

    `motion`: how what stood there becomes what it brings; None where that is not known.
    """

    birth: int
    splats: Splats
    start_offsets: Bytes  # (N,) frames after birth
    rows: Ints | None = None  # (N,) rising, the rows that change; None: whole
    motion: Motion | None = None

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
        """Bytes in memory; a slice with `rows` holds only those Gaussians."""
        rows_bytes = 0 if self.rows is None else self.rows.nbytes
        motion_bytes = 0 if self.motion is None else self.motion.num_bytes
        return self.splats.num_bytes + self.start_offsets.nbytes + rows_bytes + motion_bytes

    def lane(self, swin_size: int) -> int:
        """The lane that this slice takes over, or changes."""
        return self.birth % swin_size

    def active(self, frame: int, swin_size: int) -> Flags:
        """(N,) which of the slice's own Gaussians show at `frame`."""
        if not self.birth <= frame < self.birth + swin_size:
            return np.zeros(len(self.splats), np.bool_)
        shown: Flags = self.start_offsets <= frame - self.birth
        return shown

    def check_follows(self, last_birth: int | None, swin_size: int) -> None:
        """Raises InvalidError if the slice has rows and `last_birth` is not `swin_size` before it.

        last_birth: of the slice that its lane got last; None if there was none.
        """
        if self.rows is None or last_birth == self.birth - swin_size:
            return
        found = "nothing" if last_birth is None else f"the one born at {last_birth}"
        raise InvalidError(
            f"the slice born at {self.birth} changes the one born at {self.birth - swin_size}; "
            f"its lane holds {found}"
        )

    def corrects(self, last_birth: int | None) -> bool:
        """Whether it corrects rows of the slice that its lane holds already."""
        return self.rows is not None and last_birth == self.birth


def kept_offsets(start_offsets: Bytes) -> Bytes:
    """The start offsets that kept Gaussians have from the next birth of their lane on."""
    return np.where(start_offsets == HIDDEN, np.uint8(HIDDEN), np.uint8(0))


def blank_splats(count: int, sh_degree: int) -> Splats:
    """`count` valid Gaussians that hold the place of hidden ones."""
    arrays = [np.zeros(shape, np.float32) for shape in array_shapes(count, sh_degree)]
    arrays[2][:, 0] = 1  # turned by nothing
    return Splats(*arrays)


def window_births(frame: int, swin_size: int) -> range:
    """The births of the slices that show at `frame`, oldest first: any frame can be sought exactly
    by fetching these slices and no other."""
    return range(frame - swin_size + 1, frame + 1)


def active_splats(slices: Iterable[Slice], frame: int, swin_size: int) -> Splats:
    """All Gaussians of `slices` (at least one) that show at `frame`, in the slices' order.

    Raises InvalidError for a slice with rows, which is not whole.
    """
    parts = []
    for part in slices:
        if part.rows is not None:
            raise InvalidError(f"the slice born at {part.birth} has rows; a whole one is needed")
        parts.append(part.splats.take(np.flatnonzero(part.active(frame, swin_size))))
    return Splats.concatenate(parts)
