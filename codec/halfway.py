"""Where Gaussians are between two frames."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from codec.arrays import Flags, Floats, Ints

from .errors import InvalidError
from .splats import Splats

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
