"""Files of Gaussians as slots that last: what stays the same from file to file is sent once.

Every file has the same Gaussians in the same order, and is one frame (swin_size 1). A Gaussian
keeps its slot for ever.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import numpy.typing as npt

from codec.profiles.profile import Profile
from codec.slots.lattice import Lattice, States, quantise
from codec.slots.update import KEPT, NEW, PREDICTED, Update
from codec.splats import Splats
from codec.stream.layers import RankFunction, split_counts
from codec.stream.manifest import SLOTS_VERSION, Manifest

Rows = npt.NDArray[np.int64]


class SlotFiller:
    """Makes an Update of each file in turn. N is how many Gaussians there are in each."""

    def __init__(self, first: Splats, shares: tuple[float, ...], rank: RankFunction) -> None:
        """first: of the first file, at least one Gaussian; shares: of each layer."""
        counts = split_counts(len(first), shares)
        # No layer is empty.
        self.slots = counts if min(counts) else (len(first),)
        self.order: Rows = np.argsort(-rank(first), kind="stable")
        """(N,) which Gaussian of a file each slot holds, layer after layer."""
        self.lattice = Lattice.suiting(first)
        self._states: States | None = None  # of each slot; None before the first file
        self._escaped = np.zeros(len(first), np.bool_)
        self._before = first  # in the order of slots, from the first update on

    def manifest(self, plain: Manifest) -> Manifest:
        """`plain`, which is of version 1, as that of a stream of these slots."""
        return replace(
            plain,
            version=SLOTS_VERSION,
            profile=Profile.LATTICE,
            layers=(),
            slots=self.slots,
            lattice=(self.lattice,) * len(self.slots),
        )

    def update(self, birth: int, splats: Splats) -> Update:
        """The update that makes the slots hold `splats`, of the next file.

        What is as before on the lattice is kept, what has other numbers is predicted; what the
        lattice does not hold is kept if it is the same bit by bit, else new.
        """
        splats = splats.take(self.order)
        states, fits = quantise(splats, self.lattice, self._states)
        statuses = np.full(len(splats), NEW, np.uint8)
        if self._states is not None:
            before = self._states
            same = (states.positions == before.positions).all(axis=1)
            same &= (states.attributes == before.attributes).all(axis=1)
            lasts = fits & ~self._escaped
            statuses[lasts] = np.where(same[lasts], KEPT, PREDICTED)
            statuses[~fits & self._escaped & _equal(splats, self._before)] = KEPT
        # What has escaped holds no integers that could be predicted from.
        nowhere = np.flatnonzero(~fits)
        states.put(nowhere, States.zeros(len(nowhere), splats.sh_degree))
        self._states, self._escaped, self._before = states, ~fits, splats
        coded = np.flatnonzero(statuses >= PREDICTED)
        escaped = ~fits[coded]
        return Update(
            birth,
            statuses,
            states.take(coded),
            np.zeros(len(coded), np.uint8),
            escaped,
            splats.take(coded[escaped]),
        )


def _equal(a: Splats, b: Splats) -> npt.NDArray[np.bool_]:
    """(N,) which have the same values."""
    same = np.ones(len(a), np.bool_)
    for x, y in zip(a.arrays, b.arrays, strict=True):
        same &= (x == y).reshape(len(a), -1).all(axis=1)
    return same
