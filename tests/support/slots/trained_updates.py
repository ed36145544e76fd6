"""Updates with the statistics of a trained stream whose slots last."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from codec.arrays import Bytes, Floats
from codec.lattice.lattice import Lattice, States, quantise
from codec.slots.slotlayout import ENDED, KEPT, NEW, PREDICTED, SlotLayout, Update
from codec.splats import Splats
from tests.support.trained_like import trained_like_splats

SHARES = (0.35, 0.15, 0.2, 0.3)
"""Share of the slots in each layer."""


def moved(splats: Splats, rng: np.random.Generator) -> Splats:
    """`splats` a frame later: slightly moved, turned and recoloured."""

    def near(values: Floats, sigma: float) -> Floats:
        return (values + rng.normal(0, sigma, values.shape)).astype(np.float32)

    return Splats(
        near(splats.means, 0.002),
        near(splats.log_scales, 0.03),
        near(splats.quats, 0.01),
        near(splats.logit_opacities, 0.03),
        near(splats.sh, 0.02),
    )


def trained_like_layout(
    num_slots: int, swin_size: int, segment_frames: int, shares: Sequence[float] = SHARES
) -> SlotLayout:
    """A layout for `trained_like_updates`. num_slots: slots of a lane."""
    lattice = Lattice.suiting(trained_like_splats(num_slots, 0))
    counts = [round(share * num_slots) for share in shares[:-1]]
    counts.append(num_slots - sum(counts))
    return SlotLayout(swin_size, tuple(counts), 0, (lattice,) * len(counts), segment_frames)


def trained_like_updates(layout: SlotLayout, num_frames: int, active: float) -> Iterator[Update]:
    """Updates of a trained-like scene in which the same slots change for several frames.

    active: share of the slots that a slice changes; nine tenths of these are predicted, the others
    new or ended.
    """
    rng = np.random.default_rng(0)
    num_slots, swin_size = layout.num_slots, layout.swin_size
    (lattice, *_) = layout.lattices
    splats = [trained_like_splats(num_slots, lane) for lane in range(swin_size)]
    states: list[States] = []
    held = []
    for n in range(swin_size):
        made, fits = quantise(splats[n], lattice)
        states.append(made)
        held.append(fits)
        statuses = np.where(fits, NEW, KEPT).astype(np.uint8)
        yield _update(n + 1 - swin_size, statuses, made)
    busy = rng.random((swin_size, num_slots)) < active
    for birth in range(1, num_frames):
        lane = (birth + swin_size - 1) % swin_size
        # A fifth of the slots are drawn again as busy or idle.
        renewed = rng.random(num_slots) < 0.2
        busy[lane] = np.where(renewed, rng.random(num_slots) < active, busy[lane])
        splats[lane] = moved(splats[lane], rng)
        made, fits = quantise(splats[lane], lattice, states[lane], 0.7)
        kind = rng.random(num_slots)
        status = np.where(kind < 0.9, PREDICTED, np.where(kind < 0.95, NEW, ENDED))
        status = np.where(~held[lane] & (status == PREDICTED), NEW, status)
        statuses = np.where(busy[lane] & fits, status, KEPT).astype(np.uint8)
        coded = np.flatnonzero(statuses >= PREDICTED)
        states[lane].put(coded, made.take(coded))
        held[lane][statuses == NEW] = True
        held[lane][statuses == ENDED] = False
        yield _update(birth, statuses, made)


def _update(birth: int, statuses: Bytes, made: States) -> Update:
    coded = np.flatnonzero(statuses >= PREDICTED)
    zeros = np.zeros(len(coded), np.uint8)
    return Update(birth, statuses, made.take(coded), zeros, zeros > 0, Splats.empty())
