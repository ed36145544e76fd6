"""The interface of an edit: its effect on the Gaussians of each slot. `rewrite` applies it.

Rule: an edit says what a slot holds afterwards. Whether that is kept, predicted or new follows from
what the edited stream held there before, so an edit cannot make a stream that does not hold
together.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from codec.arrays import Bytes, Doubles, Flags
from codec.lattice.lattice import Lattice, States
from codec.slots.slotstate import Slots
from codec.splats import Splats
from codec.stream.manifest import Manifest

HOLD = 0.75
"""Steps that a number which is put on the lattice again may be off before it is sent again: above
0.5, so that rounding twice costs no bytes."""


@dataclass(frozen=True, slots=True)
class Turn:
    """One layer of a lane just after a slice."""

    frame: int
    """Birth of the slice; below 0 for what shows in frame 0 already."""
    lane: int
    layer: int
    lattice: Lattice
    statuses: Bytes  # (S,) what the slice says; in a window's first frame new for all that is held
    slots: Slots  # (S) what the slots hold now; not to be altered

    def means(self) -> Doubles:
        """(S, 3) centres in metres as players decode them; empty slots lie at 0."""
        step = np.float32(self.lattice.position_m)
        means = (self.slots.states.positions.astype(np.float32) * step).astype(np.float64)
        means[self.slots.escape_rows] = self.slots.escapes.means
        return means


class Edit:
    """One edit. This one changes nothing; each kind of edit overrides what it alters."""

    rounds = False
    """Whether `states` may give the same integers for Gaussians that differ."""

    rearranges = False
    """Whether new Gaussians are assigned to slots again, because the edit changes their order in
    space."""

    def coarser(self, factor: float) -> Edit:
        """This edit with `factor` times the steps in all that it rounds."""
        return self

    def manifest(self, source: Manifest) -> Manifest:
        """The manifest of the edited stream."""
        return source

    def keeps(self, turn: Turn) -> Flags:
        """(S,) which slots hold something that stays; what it says of empty slots does not
        count."""
        return np.ones(len(turn.slots), np.bool_)

    def states(self, layer: int, states: States, before: States | None) -> tuple[States, Flags]:
        """`states` of `layer` on the lattice of the edited stream, and (N,) which fit there.

        before: what the edited stream holds of the same Gaussians so far; None for new ones.
        """
        return states, np.ones(len(states), np.bool_)

    def check(self) -> None:
        """Called when all frames are through, before the result appears. Raises InvalidError if it
        makes no sense."""

    def splats(self, splats: Splats) -> Splats:
        """Gaussians that escape the lattice, edited."""
        return splats
