"""The Gaussians that a lane gets once per frame, all of them or only those that change; and where
Gaussians are between two frames.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from .arrays import Bytes, Flags, Floats, Ints
from .errors import InvalidError
from .splats import Splats, array_shapes

JUMP_SIGMAS = 8.0
"""A slot that goes farther than this between two frames, in standard deviations along its longest
axis, does not move: one Gaussian ends there and another begins. In a trained stream 1 in 100 of the
slots that move goes 1.5 of them in a frame, and the farthest ones cross the room."""

LEAST_LOGIT = -30.0
"""The logit of an opacity that has faded to nothing."""


@dataclass(frozen=True, slots=True)
class Motion:
    """The changes from one frame to a later one, as the pictures between them need them.

    A slot that goes on moves from one place to the other. Where a slot ends, begins, or is given to
    another Gaussian, no Gaussian moves: the old one fades out where it was while the new one fades
    in where it will be.
    """

    rows: Ints  # (M,) rising, what changes and shows in the later frame, of the slice's lane
    before: Splats  # M; what is not there before counts as here, but transparent: see `enters`
    after: Splats  # M
    enters: Flags  # (M,) those that fade in
    leaving: Splats  # L, those that fade out
    left: Ints  # (L,) rising, where they are in the earlier frame, of the same lane

    def __post_init__(self) -> None:
        same = len(self.rows) == len(self.before) == len(self.after) == len(self.enters)
        if not same or len(self.leaving) != len(self.left):
            raise InvalidError(
                f"Motion of {len(self.rows)} rows, {len(self.before)} Gaussians before, "
                f"{len(self.after)} after and {len(self.enters)} flags, {len(self.leaving)} that "
                f"leave {len(self.left)} rows"
            )

    @staticmethod
    def of(
        rows: Ints, before: Splats, was_here: Flags, after: Splats, is_here: Flags, renewed: Flags
    ) -> Motion:
        """The motion of these M slots: what they held, and hold now, and whether they did and do.
        What is not here means nothing. renewed: those that were given to another Gaussian."""
        goes_on = was_here & is_here & ~renewed
        rows_on = np.flatnonzero(goes_on)
        goes_on[rows_on] = ~jumps(before.take(rows_on), after.take(rows_on))
        there, enters = after.take(np.flatnonzero(is_here)), ~goes_on[is_here]
        origin = [array.copy() for array in there.arrays]
        for array, earlier in zip(origin, before.arrays, strict=True):
            array[~enters] = earlier[goes_on]
        left = np.flatnonzero(was_here & ~goes_on)
        return Motion(rows[is_here], Splats(*origin), there, enters, before.take(left), rows[left])

    @property
    def num_bytes(self) -> int:
        """Bytes in memory."""
        splats = self.before, self.after, self.leaving
        arrays = self.rows, self.enters, self.left
        return sum(one.nbytes for one in arrays) + sum(one.num_bytes for one in splats)

    def at(self, share: float) -> Splats:
        """The M Gaussians when `share` of the way lies behind them, 0 to 1: positions, logarithms
        of scales, colours and opacities go along a straight line, quaternions along the shorter
        one."""
        if share >= 1:
            return self.after
        back, there = np.float32(1 - share), np.float32(share)
        log_scales, quats, _, sh = (
            back * first + there * last
            for first, last in zip(self.before.arrays[1:], self.after.arrays[1:], strict=True)
        )
        # q and -q turn alike.
        away = np.sum(self.before.quats * self.after.quats, axis=1) < 0
        quats[away] = back * self.before.quats[away] - there * self.after.quats[away]
        # None is zero: those of unit length, less than half a turn apart in four dimensions, are at
        # least 0.7 long in the middle. Others are as long as the coder lets them be.
        lost = ~quats.any(axis=1)
        quats[lost] = self.after.quats[lost]
        opacities = back * np.where(self.enters, 0, self.before.opacities)
        logits = _logits(opacities + there * self.after.opacities)
        return Splats(self.means_at(share), log_scales, quats, logits, sh)

    def means_at(self, share: float) -> Floats:
        """(M, 3) the places of the M Gaussians at `share` of the way."""
        back, there = np.float32(1 - share), np.float32(share)
        means: Floats = back * self.before.means + there * self.after.means
        return means

    def all_at(self, share: float) -> Splats:
        """All visible Gaussians at `share` of the way: the M that go on and those that fade out."""
        return Splats.concatenate([self.at(share), self.leaving_at(share)])

    def leaving_at(self, share: float) -> Splats:
        """The Gaussians that fade out, when `share` of the way is over; none at its end."""
        if share >= 1:
            return self.leaving.take(slice(0))
        means, log_scales, quats, _, sh = self.leaving.arrays
        logits = _logits(np.float32(1 - share) * self.leaving.opacities)
        return Splats(means, log_scales, quats, logits, sh)


def jumps(before: Splats, after: Splats) -> Flags:
    """(N,) where the same slots go farther than JUMP_SIGMAS."""
    distance_m = np.linalg.norm(after.means - before.means, axis=1)
    longest = np.maximum(before.log_scales.max(axis=1), after.log_scales.max(axis=1))
    with np.errstate(over="ignore"):
        jumped: Flags = distance_m > JUMP_SIGMAS * np.exp(longest)
    return jumped


def _logits(opacities: Floats) -> Floats:
    """The logits of opacities in 0..1, all finite."""
    with np.errstate(divide="ignore"):
        exact = opacities.astype(np.float64)
        logits: Floats = (np.log(exact) - np.log1p(-exact)).astype(np.float32)
    return np.clip(logits, LEAST_LOGIT, -LEAST_LOGIT)


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
