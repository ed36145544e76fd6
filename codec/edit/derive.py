"""The update that makes a lane of the edited stream hold what an edit wants there."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from codec.arrays import Bytes, Longs
from codec.lattice.lattice import States, dequantise
from codec.slots.slotstate import ESCAPED, ON_LATTICE, Slots, holds
from codec.slots.update import ENDED, KEPT, NEW, PREDICTED, Update
from codec.splats import Splats

from .edit import Edit, Turn


def derive(
    birth: int, turns: Sequence[Turn], held: Sequence[Slots], edit: Edit, joins: bool = False
) -> Update:
    """The update born at `birth`, of all layers of a lane that holds `held` in the edited stream,
    and should hold what `turns` hold in the source after `edit`.

    joins: whether `held` may be of another stream, so that Gaussians that are near are the same.
    """
    parts = [_Part(turn, slots, edit, joins) for turn, slots in zip(turns, held, strict=True)]
    return Update(
        birth,
        np.concatenate([part.statuses for part in parts]),
        States.concatenate([part.states for part in parts]),
        np.concatenate([part.start_offsets for part in parts]),
        np.concatenate([part.escaped for part in parts]),
        Splats.concatenate([part.escapes for part in parts]),
    )


NEAR, NEAR_STEPS = 32, 3.0
"""Steps, of a coordinate and in the mean of the attributes, within which a Gaussian of a stream is
taken for the one that the stream before it held in the same slot: what was cut is joined again."""


class _Part:
    """One layer of the update."""

    def __init__(self, turn: Turn, held: Slots, edit: Edit, joins: bool) -> None:
        slots, said = turn.slots, turn.statuses
        wanted = holds(slots.conditions) & edit.keeps(turn)
        had = holds(held.conditions)
        # Unless a Gaussian is new, its slot in the edited stream holds it already, or nothing.
        goes_on = wanted & had & (said != NEW)
        moves = np.flatnonzero(goes_on & (said == PREDICTED) & (held.conditions == ON_LATTICE))
        fresh = np.flatnonzero(wanted & ~(goes_on & (said == KEPT)))
        fresh = np.setdiff1d(fresh, moves, assume_unique=True)
        self.statuses: Bytes = np.full(len(slots), KEPT, np.uint8)
        self.statuses[~wanted & (had | (said == ENDED))] = ENDED
        self.statuses[moves], self.statuses[fresh] = PREDICTED, NEW

        states = States.zeros(len(slots), slots.states.sh_degree)
        escaped = np.zeros(len(slots), np.bool_)
        before = held.states.take(moves)
        moved, fits = edit.states(turn.layer, slots.states.take(moves), before)
        states.put(moves, moved)
        self._escape(moves[~fits], escaped)
        if edit.rounds:
            self.statuses[moves[fits & ~moved.differ(before)]] = KEPT
        inside = fresh[slots.conditions[fresh] == ON_LATTICE]
        self._escape(fresh[slots.conditions[fresh] == ESCAPED], escaped)
        brought, fits = edit.states(turn.layer, slots.states.take(inside), None)
        states.put(inside, brought)
        self._escape(inside[~fits], escaped)
        starts = np.where(said == NEW, slots.starts, 0).astype(np.uint8)
        if joins:
            known = (held.conditions == ON_LATTICE) & (self.statuses == NEW) & ~escaped
            off = np.abs(states.numbers() - held.states.numbers())
            known &= (starts == 0) & (off[:, :3].max(axis=1) <= NEAR)
            known &= off[:, 3:].mean(axis=1) <= NEAR_STEPS
            self.statuses[known] = np.where(off[known].any(axis=1), PREDICTED, KEPT)

        coded = np.flatnonzero(self.statuses >= PREDICTED)
        self.states = states.take(coded)
        self.start_offsets = np.where(self.statuses == NEW, starts, 0).astype(np.uint8)[coded]
        self.escaped = escaped[coded]
        self.escapes = edit.splats(_floats(turn, coded[self.escaped]))

    def _escape(self, rows: Longs, escaped: np.ndarray) -> None:
        self.statuses[rows] = NEW
        escaped[rows] = True


def _floats(turn: Turn, rows: Longs) -> Splats:
    """The Gaussians in the slots `rows` of the source, as players decode them."""
    slots = turn.slots
    splats = dequantise(slots.states.take(rows), turn.lattice)
    place_of = np.full(len(slots), -1, np.int64)
    place_of[slots.escape_rows] = np.arange(len(slots.escape_rows))
    places = place_of[rows]
    for array, source in zip(splats.arrays, slots.escapes.arrays, strict=True):
        array[places >= 0] = source[places[places >= 0]]
    return splats
