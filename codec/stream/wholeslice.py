"""A slice sent whole, as SwinGS does (paper, section 5): every slot of its lane is new."""

from __future__ import annotations

import numpy as np

from codec.arrays import Flags, Longs
from codec.errors import InvalidError
from codec.kernel import kernel
from codec.lattice.lattice import POSITION_LIMIT, States, quantise
from codec.lattice.morton import BITS_PER_AXIS, interleave
from codec.slice import HIDDEN, Slice
from codec.slots.slotlayout import SlotLayout
from codec.slots.update import ENDED, NEW, Update

from .layers import RankFunction, split_layers

SHIFT = (2 * POSITION_LIMIT).bit_length() - 1 - BITS_PER_AXIS
"""Low bits of a position that do not count along the curve."""

REACH = 256
"""Gaussians on either side along the curve that are tried as the next one."""


def whole_update(
    slice: Slice, layout: SlotLayout, rank: RankFunction, exact: bool = False
) -> Update:
    """The update that makes a lane hold `slice` and nothing else: its Gaussians are new, the slots
    that they leave over are ended. Hidden Gaussians are left out.

    exact: every Gaussian escapes the lattice, so that a reader gets each float32 as it is.
    Raises InvalidError for a slice that `layout` has no room for.
    """
    if slice.rows is not None:
        raise InvalidError("a slice with rows is not whole; append a whole one, or an Update")
    shown = np.flatnonzero(slice.start_offsets != HIDDEN)
    splats, start_offsets = slice.splats.take(shown), slice.start_offsets[shown]
    if len(splats) > layout.num_slots:
        raise InvalidError(f"{len(splats)} Gaussians, at most {layout.num_slots} a slice")
    if splats.sh_degree != layout.sh_degree:
        raise InvalidError(f"SH degree {splats.sh_degree}, not {layout.sh_degree}")
    statuses = np.full(layout.num_slots, ENDED, np.uint8)
    rows, parts, fitting = [], [], []
    for layer, chosen in enumerate(split_layers(splats, layout.slots, rank)):
        if exact:
            states, fits = States.zeros(len(chosen), splats.sh_degree), np.zeros(len(chosen), bool)
        else:
            states, fits = quantise(splats.take(chosen), layout.lattices[layer])
            order = neighbours_first(states, fits)
            states, fits, chosen = states.take(order), fits[order], chosen[order]
        statuses[layout.row_edges[layer] :][: len(chosen)] = NEW
        rows.append(chosen)
        parts.append(states)
        fitting.append(fits)
    taken, escaped = np.concatenate(rows), ~np.concatenate(fitting)
    return Update(
        slice.birth,
        statuses,
        States.concatenate(parts),
        start_offsets[taken],
        escaped,
        splats.take(taken[escaped]),
    )


def neighbours_first(states: States, fits: Flags) -> Longs:
    """The order in which positions cost few bits, for each is coded as the difference to the one
    before. What does not fit comes last."""
    inside = np.flatnonzero(fits)
    positions = states.positions[inside]
    cells = (positions.astype(np.int64) + POSITION_LIMIT) >> SHIFT
    curve = np.argsort(interleave(cells), kind="stable")
    chain = np.empty(len(inside), np.int64)
    _chain(positions, curve, chain)
    return np.concatenate([inside[chain], np.flatnonzero(~fits)])


@kernel(nogil=True)
def _chain(positions, curve, chain):  # type: ignore[no-untyped-def]
    """Fills chain with `curve`, an order of the positions, so that each is followed by the one that
    costs the fewest bits among the next REACH on either side of it."""
    count = curve.shape[0]
    # A ring of the places on the curve that are left; the last one is its beginning and end.
    after = np.empty(count + 1, np.int64)
    before = np.empty(count + 1, np.int64)
    for i in range(count + 1):
        after[i] = i + 1 if i < count else 0
        before[i] = i - 1 if i > 0 else count
    at = after[count]
    for n in range(count):
        row = curve[at]
        chain[n] = row
        onward, back = after[at], before[at]
        after[back], before[onward] = onward, back
        best, least = onward if onward < count else back, 1 << 30
        for _ in range(REACH):
            for side in (onward, back):
                if side < count:
                    bits = 0
                    for axis in range(3):
                        step = abs(positions[curve[side], axis] - positions[row, axis])
                        while step:
                            step >>= 1
                            bits += 1
                    if bits < least:
                        best, least = side, bits
            onward = after[onward] if onward < count else count
            back = before[back] if back < count else count
        at = best
