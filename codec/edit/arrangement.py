"""The order of a source's Gaussians in the slots of the edited stream.

A position is coded as the difference to that of the new Gaussian before it, so a writer orders the
slots for the axes of the world. Turned axes call for another order. Which slot of its layer a new
Gaussian gets is free, and nobody sees it.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from codec.arrays import Longs
from codec.slots.slotstate import holds
from codec.slots.update import NEW
from codec.stream.wholeslice import neighbours_first

from .edit import Edit, Turn


class Arrangement:
    """Follows which slot of the source each slot of the edited stream stands for."""

    def __init__(self) -> None:
        self._sources: dict[tuple[int, int], Longs] = {}
        """(S,) slots of the source for each lane and layer."""

    def arranged(self, turn: Turn, edit: Edit) -> Turn:
        """`turn`, of the next slice of its lane, with the slots of the edited stream.

        New Gaussians are ordered anew, by their places after `edit`, where they are most of what
        the slots hold; else they would leave the neighbours beside whose slots they were put.
        """
        slots = turn.slots
        sources = self._sources.setdefault((turn.lane, turn.layer), np.arange(len(slots)))
        is_new = turn.statuses == NEW
        if 2 * np.count_nonzero(is_new) > np.count_nonzero(holds(slots.conditions)):
            places = np.flatnonzero(is_new[sources])
            rows = sources[places]
            states, fits = edit.states(turn.layer, slots.states.take(rows), None)
            sources[places] = rows[neighbours_first(states, fits)]
        return replace(turn, statuses=turn.statuses[sources], slots=slots.rearranged(sources))
