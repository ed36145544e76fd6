"""The frame of a passing slice that is missing: what goes on is on its way to the next slice."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from codec.halfway import JUMP_SIGMAS
from codec.lattice.lattice import Bytes, Flags, Lattice, States

from .passing import Passing
from .slotlayout import SlotLayout
from .slotstate import ON_LATTICE, Delta, Rows, Slots
from .update import KEPT, PREDICTED

TURNS = slice(6, 9)
"""Where the rotation stands among the numbers of a state."""


def interpolated(
    layout: SlotLayout,
    birth: int,
    stay: Sequence[Slots],
    next_statuses: Sequence[Bytes],
    next_deltas: Sequence[Delta | None],
) -> Passing:
    """The substitute for the passing slice of `birth`: each predicted Gaussian that does not jump
    is between its state in `stay` and the one that the next slice that stays gives it.

    next_statuses, next_deltas: that slice, layer after layer; None for a layer that has not come.
    """
    share = birth % layout.temporal_period / layout.temporal_period
    statuses, shown = [], []
    for layer, slots in enumerate(stay):
        said = np.full(len(slots), KEPT, np.uint8)
        delta = next_deltas[layer]
        if delta is not None and (next_statuses[layer] == PREDICTED).any():
            rows, states = _moved(slots, next_statuses[layer], delta, layout.lattices[layer], share)
            said[rows] = PREDICTED
            slots = slots.copy()
            slots.states.put(rows, states)
        statuses.append(said)
        shown.append(slots)
    return Passing(birth, statuses, None, shown)


def _moved(
    slots: Slots, statuses: Bytes, delta: Delta, lattice: Lattice, share: float
) -> tuple[Rows, States]:
    """The slots that move, and their states when `share` of the way is over."""
    rows = np.flatnonzero(statuses == PREDICTED)
    after = delta.states.take(slice(0, len(rows)))  # a delta begins with the predicted
    before = slots.states.take(rows)
    moves = (slots.conditions[rows] == ON_LATTICE) & ~_jumps(before, after, lattice)
    rows, before, after = rows[moves], before.take(moves), after.take(moves)
    first, last = before.numbers(), after.numbers()
    # w is never negative: of a rotation that passes w = 0 the other numbers change their signs.
    turned = (first[:, TURNS] * last[:, TURNS]).sum(axis=1) * lattice.rotation**2
    last[turned < -0.5, TURNS] = first[turned < -0.5, TURNS]
    between = np.floor((1 - share) * first + share * last + 0.5).astype(np.int32)
    return rows, States(between[:, :3].copy(), between[:, 3:].astype(np.uint8))


def _jumps(before: States, after: States, lattice: Lattice) -> Flags:
    """(N,) which go too far for a motion, see codec.halfway."""
    away = after.positions.astype(np.float64) - before.positions
    scales = np.maximum(
        before.attributes[:, :3].view(np.int8), after.attributes[:, :3].view(np.int8)
    )
    with np.errstate(over="ignore"):
        longest_m = np.exp(scales.max(axis=1) * lattice.log_scale + lattice.log_scale_base)
        jumped: Flags = np.linalg.norm(away, axis=1) * lattice.position_m > JUMP_SIGMAS * longest_m
    return jumped
