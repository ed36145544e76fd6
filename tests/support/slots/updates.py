"""Random updates of slots, and a plain model of their meaning: Python lists and dicts.

The model is independent of the coded bytes and reads only the Updates. It stores the Gaussian of
each slot as a tuple, or None for an empty slot.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from codec.lattice.lattice import POSITION_LIMIT, Lattice, States, num_attributes
from codec.slots.slotlayout import ENDED, KEPT, NEW, PREDICTED, SlotLayout, Update
from codec.splats import Splats, array_shapes

LATTICE = Lattice(0.01, 0.125, 1 / 60, 0.056, 161)


def small_layout(
    swin_size: int = 2,
    slots: tuple[int, ...] = (5, 3),
    sh_degree: int = 0,
    segment_frames: int = 4,
) -> SlotLayout:
    lattices = tuple(
        Lattice(0.01 * (n + 1), 0.125, 1 / 60, 0.056, 161 - n) for n in range(len(slots))
    )
    return SlotLayout(swin_size, slots, sh_degree, lattices, segment_frames)


def patternless_states(
    rng: np.random.Generator, levels: list[int], sh_degree: int, wild: bool = False
) -> States:
    """A random Gaussian for each of `levels`, the opacity levels of its layer; positions are near
    zero, or anywhere on the lattice if `wild`."""
    count, limit = len(levels), POSITION_LIMIT if wild else 500
    attributes = rng.integers(0, 256, (count, num_attributes(sh_degree))).astype(np.uint8)
    attributes[:, -1] = [rng.integers(0, n) for n in levels]
    return States(rng.integers(1 - limit, limit, (count, 3)).astype(np.int32), attributes)


def patternless_splats(rng: np.random.Generator, count: int, sh_degree: int) -> Splats:
    return Splats(
        *(rng.normal(size=s).astype(np.float32) + 0.01 for s in array_shapes(count, sh_degree))
    )


@dataclass
class Model:
    """State of each slot: None, or ("lattice", bytes of its state) or ("escape", bytes)."""

    layout: SlotLayout
    held: dict[tuple[int, int], tuple[str, bytes] | None] = field(default_factory=dict)
    """State by (lane, row); rows are counted over all layers."""

    def __post_init__(self) -> None:
        for lane in range(self.layout.swin_size):
            for row in range(self.layout.num_slots):
                self.held[lane, row] = None

    def take(self, update: Update) -> None:
        lane = update.birth % self.layout.swin_size
        coded = iter(range(len(update.states)))
        escapes = iter(range(len(update.escapes)))
        for row, status in enumerate(update.statuses):
            if status == ENDED:
                self.held[lane, row] = None
            if status in (PREDICTED, NEW):
                i = next(coded)
                if update.escaped[i]:
                    one = update.escapes.take(np.array([next(escapes)]))
                    self.held[lane, row] = "escape", b"".join(a.tobytes() for a in one.arrays)
                else:
                    state = update.states.take(np.array([i]))
                    value = state.positions.tobytes() + state.attributes.tobytes()
                    self.held[lane, row] = "lattice", value


def levels_of(layout: SlotLayout) -> list[int]:
    """Opacity levels of each row."""
    return [
        lattice.opacity_levels
        for lattice, count in zip(layout.lattices, layout.slots, strict=True)
        for _ in range(count)
    ]


def patternless_update(
    rng: np.random.Generator, model: Model, birth: int, wild: bool = False, calm: int = 1
) -> Update:
    """A random valid update that follows the updates in `model`. calm: mean number of kept slots
    for each new one."""
    layout = model.layout
    levels, lane = levels_of(layout), birth % layout.swin_size
    statuses = []
    for row in range(layout.num_slots):
        held = model.held[lane, row]
        may = [KEPT] * calm + [ENDED, NEW]
        if held is not None and held[0] == "lattice":
            may += [PREDICTED, PREDICTED]
        statuses.append(int(rng.choice(may)))
    coded = [row for row, status in enumerate(statuses) if status in (PREDICTED, NEW)]
    is_new = np.array([statuses[row] == NEW for row in coded], np.bool_)
    escaped = is_new & (rng.random(len(coded)) < 0.2)
    late = rng.random() < 0.5
    offsets = rng.integers(0, layout.swin_size if late else 1, len(coded)) * is_new
    return Update(
        birth,
        np.array(statuses, np.uint8),
        patternless_states(rng, [levels[row] for row in coded], layout.sh_degree, wild),
        offsets.astype(np.uint8),
        escaped,
        patternless_splats(rng, int(escaped.sum()), layout.sh_degree),
    )


def patternless_updates(
    layout: SlotLayout, num_frames: int, seed: int = 0, wild: bool = False, calm: int = 1
) -> list[Update]:
    """Random updates of a stream of `num_frames` frames."""
    rng, model = np.random.default_rng(seed), Model(layout)
    updates = []
    for birth in range(1 - layout.swin_size, num_frames):
        updates.append(patternless_update(rng, model, birth, wild, calm if birth > 0 else 1))
        model.take(updates[-1])
    return updates
