"""A slice cut into layers by importance, and sent whole, as SwinGS does (paper, section 5): every
slot of its lane is new.

Rule: layers 0..n are always usable together, for any n; a layer alone is of no use.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from enum import StrEnum
from itertools import accumulate, pairwise

import numpy as np

from codec.arrays import Flags, Floats, Longs
from codec.errors import InvalidError
from codec.kernel import kernel
from codec.lattice.forms import BITS_PER_AXIS, interleave
from codec.lattice.lattice import POSITION_LIMIT, States, quantise
from codec.slice import HIDDEN, Slice
from codec.slots.slotlayout import ENDED, NEW, SlotLayout, Update
from codec.splats import Splats

RankFunction = Callable[[Splats], Floats]
"""Gives (N,) importances; the higher, the earlier the layer."""


def opacity_rank(splats: Splats) -> Floats:
    """(N,) importance by opacity alone, as the paper drops the tail of a slice."""
    return splats.logit_opacities


def coverage_rank(splats: Splats) -> Floats:
    """(N,) importance by what a Gaussian can paint: opacity times its widest section."""
    scales = splats.log_scales.astype(np.float64)
    widest = scales.sum(axis=1) - scales.min(axis=1)
    log_opacity = -np.logaddexp(0.0, -splats.logit_opacities.astype(np.float64))
    importance: Floats = (widest + log_opacity).astype(np.float32)
    return importance


def given_rank(splats: Splats) -> Floats:
    """(N,) importance by place in the slice, the most important first."""
    places: Floats = -np.arange(len(splats), dtype=np.float32)
    return places


class Rank(StrEnum):
    """The measure by which a slice is ordered into layers; RANKS has the functions.

    An importance that does not follow from the Gaussians alone, such as what they add to pictures,
    is given by the order of the slice, with `given`.
    """

    OPACITY = "opacity"
    COVERAGE = "coverage"
    GIVEN = "given"


RANKS: dict[Rank, RankFunction] = {
    Rank.OPACITY: opacity_rank,
    Rank.COVERAGE: coverage_rank,
    Rank.GIVEN: given_rank,
}


def split_counts(count: int, shares: tuple[float, ...]) -> tuple[int, ...]:
    """How many of `count` Gaussians each layer has; it may have none."""
    edges = np.rint(np.cumsum((0.0, *shares)) * count).astype(np.int64)
    edges[-1] = count
    return tuple(np.diff(edges).tolist())


def layer_counts(count: int, slots: Sequence[int]) -> tuple[int, ...]:
    """How many of `count` Gaussians, sum(slots) at most, each layer takes into its slots: about
    equally full ones."""
    return split_counts(count, tuple(n / sum(slots) for n in slots))


def split_layers(splats: Splats, slots: Sequence[int], rank: RankFunction) -> list[Longs]:
    """The rows of `splats` that belong into each layer, the most important ones first.

    Inside a layer they keep their order; equal ranks fall to the earlier layer in order.
    """
    order = np.argsort(-rank(splats), kind="stable")
    edges = pairwise(accumulate(layer_counts(len(splats), slots), initial=0))
    return [np.sort(order[first:last]) for first, last in edges]


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
