"""Where Gaussians are between two frames."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from .errors import InvalidError
from .splats import Splats


@dataclass(frozen=True, slots=True)
class Motion:
    """Gaussians that a slice moves or alters: the same ones, before it and from its birth on."""

    rows: npt.NDArray[np.int32]  # (M,) rising, of the slice's lane
    before: Splats  # M
    after: Splats  # M

    def __post_init__(self) -> None:
        if not len(self.rows) == len(self.before) == len(self.after):
            raise InvalidError(
                f"Motion of {len(self.rows)} rows, {len(self.before)} Gaussians before and "
                f"{len(self.after)} after"
            )

    @property
    def num_bytes(self) -> int:
        """Bytes in memory."""
        return self.rows.nbytes + self.before.num_bytes + self.after.num_bytes

    def at(self, share: float) -> Splats:
        """The M Gaussians when `share` of the way lies behind them, 0 to 1; each attribute goes
        along a straight line, quaternions along the shorter one."""
        if share <= 0:
            return self.before
        if share >= 1:
            return self.after
        back, there = np.float32(1 - share), np.float32(share)
        means, log_scales, quats, logits, sh = (
            back * first + there * last
            for first, last in zip(self.before.arrays, self.after.arrays, strict=True)
        )
        # q and -q turn alike.
        away = np.sum(self.before.quats * self.after.quats, axis=1) < 0
        quats[away] = back * self.before.quats[away] - there * self.after.quats[away]
        # None is zero: those of unit length, less than half a turn apart in four dimensions, are at
        # least 0.7 long in the middle. Others are as long as the coder lets them be.
        lost = ~quats.any(axis=1)
        quats[lost] = self.after.quats[lost]
        return Splats(means, log_scales, quats, logits, sh)
