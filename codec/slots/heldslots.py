"""The slots of a lane just before a slice changes them, from which the slice's motion comes."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from codec.arrays import Flags, Ints
from codec.halfway import Motion
from codec.slice import Slice
from codec.splats import Splats


@dataclass(frozen=True, slots=True)
class HeldSlots:
    """M slots of a lane before a slice that changes them."""

    rows: Ints  # (M,) rising, counted over all layers
    splats: Splats  # M
    here: Flags  # (M,) where there is a Gaussian
    renewed: Flags  # (M,) those that the slice does not predict

    def with_motion(self, changed: Slice) -> Slice:
        """`changed`, with the motion of these rows. Gaussians that start later do not show yet."""
        assert changed.rows is not None
        places = np.searchsorted(changed.rows, self.rows)
        is_here = changed.start_offsets[places] == 0
        motion = Motion.of(
            self.rows, self.splats, self.here, changed.splats.take(places), is_here, self.renewed
        )
        return replace(changed, motion=motion)
