"""The update that a trainer hands over for one slice: what becomes of each slot of a lane."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from codec.arrays import Bytes, Flags
from codec.errors import InvalidError
from codec.lattice.lattice import POSITION_LIMIT, States
from codec.splats import Splats

from .slotlayout import SlotLayout

KEPT, ENDED, PREDICTED, NEW = range(4)
"""The status of a slot: what a slice says of it."""


@dataclass(frozen=True, slots=True)
class Update:
    """The slice born at `birth`. M is how many slots its statuses call predicted or new.

    The first updates of a stream, of the births 1 - swin_size .. 0, have no slot predicted: they
    say what frame 0 shows.
    """

    birth: int
    statuses: Bytes  # (S,) KEPT, ENDED, PREDICTED or NEW, layer after layer
    states: States  # M, in the order of the slots: what they become, not a difference
    start_offsets: Bytes  # (M,) frames after birth; 0 for the predicted
    escaped: Flags  # (M,) new Gaussians that the lattice does not hold
    escapes: Splats  # those, in order; their states mean nothing

    @staticmethod
    def keeping(birth: int, layout: SlotLayout) -> Update:
        """One that keeps all slots."""
        return Update(
            birth,
            np.zeros(layout.num_slots, np.uint8),
            States.zeros(0, layout.sh_degree),
            np.zeros(0, np.uint8),
            np.zeros(0, np.bool_),
            Splats.empty(layout.sh_degree),
        )

    def check(self, layout: SlotLayout) -> None:
        """Raises InvalidError unless the parts agree and `layout` holds them."""
        what = f"update born at {self.birth}"
        if self.statuses.shape != (layout.num_slots,) or self.statuses.dtype != np.uint8:
            raise InvalidError(
                f"{what}: statuses are {self.statuses.dtype} {self.statuses.shape}, "
                f"not uint8 ({layout.num_slots},)"
            )
        if self.statuses.max() > NEW:
            raise InvalidError(f"{what}: a status is {self.statuses.max()}, at most {NEW}")
        coded = np.flatnonzero(self.statuses >= PREDICTED)
        count, attributes = len(coded), layout.num_planes - 3
        arrays = (
            ("positions", self.states.positions, (count, 3), np.int32),
            ("attributes", self.states.attributes, (count, attributes), np.uint8),
            ("start_offsets", self.start_offsets, (count,), np.uint8),
            ("escaped", self.escaped, (count,), np.bool_),
        )
        for name, array, shape, dtype in arrays:
            if array.shape != shape or array.dtype != dtype:
                raise InvalidError(
                    f"{what}: {name} are {array.dtype} {array.shape}, not {np.dtype(dtype)} {shape}"
                )
        if count and self.start_offsets.max() >= layout.swin_size:
            raise InvalidError(
                f"{what}: start offset {self.start_offsets.max()} of {layout.swin_size} frames"
            )
        if self.start_offsets[self.statuses[coded] == PREDICTED].any():
            raise InvalidError(f"{what}: a predicted Gaussian starts late; it goes on at once")
        if len(self.escapes) != np.count_nonzero(self.escaped):
            raise InvalidError(
                f"{what}: {len(self.escapes)} escapes, "
                f"{np.count_nonzero(self.escaped)} are said to escape"
            )
        if len(self.escapes) and self.escapes.sh_degree != layout.sh_degree:
            raise InvalidError(
                f"{what}: SH degree {self.escapes.sh_degree}, not {layout.sh_degree}"
            )
        if (self.escaped & (self.statuses[coded] == PREDICTED)).any():
            raise InvalidError(f"{what}: a predicted Gaussian escapes; make it a new one")
        inside = self.states.take(~self.escaped)
        if not (abs(inside.positions.astype(np.int64)) < POSITION_LIMIT).all():
            raise InvalidError(f"{what}: a position is outside the lattice; let it escape")
        levels = np.repeat([lattice.opacity_levels for lattice in layout.lattices], layout.slots)
        if (inside.attributes[:, -1] >= levels[coded[~self.escaped]]).any():
            raise InvalidError(f"{what}: an opacity is outside the lattice")
