"""The streams of the conformance suite, as the updates from which each is made.

A stream is made of integers and exact float32 values, so that every platform makes the same one.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from codec.lattice.lattice import Lattice, States
from codec.slots.encoder import SlotEncoder
from codec.slots.slotlayout import ENDED, KEPT, NEW, PREDICTED, SlotLayout, Update
from codec.slots.state import ON_LATTICE
from codec.splats import Splats, array_shapes

LATTICES = (
    Lattice(0.001, 0.05, 1 / 127, 0.02, 256, -3.0),
    Lattice(0.01, 0.125, 1 / 60, 0.056, 41),
    Lattice(1e-6, 1e6, 1.0, 1.0, 2, 1e3),
)


@dataclass(frozen=True, slots=True)
class Case:
    """One stream."""

    name: str
    num_frames: int
    swin_size: int
    slots: tuple[int, ...]
    segment_frames: int
    sh_degree: int = 0
    far: bool = False
    """Whether positions cover the whole lattice, so that residuals are long."""
    late: bool = False
    """Whether some new Gaussians start late."""
    escapes: bool = False
    still: bool = False
    """Whether nothing changes after frame 0."""

    @property
    def layout(self) -> SlotLayout:
        lattices = LATTICES[: len(self.slots)]
        return SlotLayout(self.swin_size, self.slots, self.sh_degree, lattices, self.segment_frames)


CASES = (
    Case("leases", 14, 2, (6, 4), 5),
    Case("one-lane", 10, 1, (7,), 4, sh_degree=1),
    Case("still", 6, 2, (5,), 3, still=True),
    Case("far", 12, 2, (5, 3, 2), 5, far=True),
    Case("late-and-escaped", 14, 3, (6, 2), 6, late=True, escapes=True),
    Case("harmonics", 8, 2, (4, 2), 4, sh_degree=3, escapes=True),
)

STATUSES = KEPT, PREDICTED, NEW, KEPT, PREDICTED, ENDED, KEPT


def made_updates(case: Case) -> list[Update]:
    """The updates of the stream of `case`."""
    layout, encoder = case.layout, SlotEncoder(case.layout)
    updates = []
    for birth in range(1 - case.swin_size, case.num_frames):
        lane = encoder.lanes[layout.lane(birth)]
        conditions = np.concatenate([slots.conditions for slots in lane])
        rows = np.arange(layout.num_slots)
        statuses = np.array(STATUSES, np.uint8)[(3 * rows + 5 * birth) % 7]
        if birth <= 0:
            statuses = np.where(rows % 5 == 3, KEPT, NEW).astype(np.uint8)
        elif case.still:
            statuses[:] = KEPT
        lost = (statuses == PREDICTED) & (conditions != ON_LATTICE)
        statuses[lost] = NEW
        updates.append(_update(case, birth, statuses))
        encoder.append(updates[-1])
    return updates


def _update(case: Case, birth: int, statuses: np.ndarray[tuple[int], np.dtype[np.uint8]]) -> Update:
    layout = case.layout
    coded = np.flatnonzero(statuses >= PREDICTED)
    is_new = statuses[coded] == NEW
    at = coded + 100 * (birth + case.swin_size)
    levels = np.repeat([lattice.opacity_levels for lattice in layout.lattices], layout.slots)
    spread = 40_000 if case.far else 1
    axes = (at[:, None] * np.array([37, 53, 71]) % 401 - 200) * spread
    columns = np.arange(layout.num_planes - 3)
    attributes = (at[:, None] * 29 + columns * 83) % 256
    attributes[:, -1] %= levels[coded]
    escaped = is_new & (at % 3 == 1) & case.escapes
    count = int(escaped.sum())
    floats = [
        (np.arange(np.prod(shape)).reshape(shape) % 97 - 40.25).astype(np.float32)
        for shape in array_shapes(count, case.sh_degree)
    ]
    offsets = at % case.swin_size * is_new * case.late
    return Update(
        birth,
        statuses,
        States(axes.astype(np.int32), attributes.astype(np.uint8)),
        offsets.astype(np.uint8),
        escaped,
        Splats(*floats),
    )
