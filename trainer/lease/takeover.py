"""A seam: slots take over, a few with each frame, what another training holds of them.

Two trainings that began alike, but learned from different frames, hold different Gaussians for the
same scene. To change from one to the other at once would be seen. So the first goes on for some
frames; with each of them more of its slots follow the second, those that do not learn to live with
those that do, and with the last all follow. From then on the updates of the second hold for a
player that received those of the first.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from codec.arrays import Bytes, Flags, Floats, Ints, Longs
from codec.errors import InvalidError
from codec.lattice.forms import interleave
from codec.lattice.lattice import States
from codec.slots.slotlayout import KEPT, NEW, Update
from codec.splats import ARRAY_NAMES, Splats

CELLS_PER_TURN = 1
"""Cells of the scene that change to another training with each birth. More and smaller ones have
longer borders, where neither side has learned to live with the other."""

NEAR_STEPS = 64
"""Steps of the lattice up to which a slot that changes to another training's Gaussian goes there
as a difference. Farther away it is another Gaussian: between two frames it must not fly there."""


@dataclass(frozen=True, slots=True)
class PlayerState:
    """A player's slots of one lane since the slice of `birth`."""

    birth: int
    states: States  # (S,) zeros where there is nothing; those of the escaped mean nothing
    shows: Flags  # (S,) whether there is a Gaussian
    escaped: Flags  # (S,) whether it is one that the lattice does not hold
    start_offsets: Bytes  # (S,) frames after birth; 0 where the slice brings nothing new
    splats: Splats  # (S,) the Gaussians as they are drawn

    def as_opening(self) -> Update:
        """The update that says all of it to a player that knows nothing."""
        shown = np.flatnonzero(self.shows)
        escaped = self.escaped[shown]
        return Update(
            self.birth,
            np.where(self.shows, NEW, KEPT).astype(np.uint8),
            self.states.take(shown),
            self.start_offsets[shown],
            escaped,
            self.splats.take(shown[escaped]),
        )

    def to_arrays(self) -> dict[str, npt.NDArray[np.generic]]:
        """All of it by name, for `from_arrays`."""
        return {
            "birth": np.array(self.birth),
            "positions": self.states.positions,
            "attributes": self.states.attributes,
            "shows": self.shows,
            "escaped": self.escaped,
            "start_offsets": self.start_offsets,
            **dict(zip(ARRAY_NAMES, self.splats.arrays, strict=True)),
        }

    @staticmethod
    def from_arrays(arrays: Mapping[str, npt.NDArray[np.generic]]) -> PlayerState:
        """The opposite of `to_arrays`."""
        given = dict(arrays)
        return PlayerState(
            int(given["birth"]),
            States(given["positions"], given["attributes"]),  # type: ignore[arg-type]
            given["shows"],  # type: ignore[arg-type]
            given["escaped"],  # type: ignore[arg-type]
            given["start_offsets"],  # type: ignore[arg-type]
            Splats(*(given[name] for name in ARRAY_NAMES)),  # type: ignore[arg-type]
        )


class Crossfade:
    """Which slots follow the other training by now. The same seed makes the same choices.

    Slots follow cell by cell of the scene: what one training splits between neighbours the other
    splits in another way, so a few of them alone show what neither has learned.
    """

    def __init__(self, other: Mapping[int, PlayerState], swin_size: int, seed: int) -> None:
        """other: what the other training holds, by birth: of births that follow one another, one
        of each lane at least."""
        births = sorted(other)
        if len(births) < swin_size or births != list(range(births[0], births[-1] + 1)):
            raise InvalidError(f"a seam of births {births}: give at least {swin_size} in a row")
        self._other = other
        # Of each lane what it holds in the end, lane after lane.
        last = sorted((other[b] for b in births[-swin_size:]), key=lambda h: h.birth % swin_size)
        means = np.concatenate([held.splats.means for held in last])
        rng = np.random.default_rng(seed)
        self._turns = births[0] + turns(means, len(births), rng)
        slice_size = len(means) // swin_size
        for lane, held in enumerate(last):  # at the end all of them do
            mine = self._turns[lane * slice_size : (lane + 1) * slice_size]
            np.minimum(mine, held.birth, out=mine)
        self.follows = np.zeros(len(means), np.bool_)
        """(num_gs,) the slots that follow, in the newest life of their lane."""

    def held(self, birth: int) -> PlayerState | None:
        """The other training's slots of the lane of `birth`; None outside the seam."""
        return self._other.get(birth)

    def go_on(self, birth: int, lane: slice) -> Ints:
        """Has more slots of `lane`, that of `birth`, follow; gives all that do."""
        self.follows[lane] = (self._turns[lane] <= birth) & (birth in self._other)
        following: Ints = (lane.start + np.flatnonzero(self.follows[lane])).astype(np.int32)
        return following


def turns(means: Floats, count: int, rng: np.random.Generator) -> Longs:
    """(N,) 0 to count - 1: whose turn it is when, as many each time, in cells of the scene that are
    drawn at random. means: (N, 3), metres, world."""
    low, high = np.percentile(means, 2, axis=0), np.percentile(means, 98, axis=0)
    extent = max(float((high - low).max()), 1e-6)
    places = np.clip((means - low) * (((1 << 16) - 1) / extent), 0, (1 << 16) - 1)
    order = np.argsort(interleave(places.astype(np.int64)), kind="stable")
    num_cells = CELLS_PER_TURN * count
    cells = np.empty(len(means), np.int64)
    cells[order] = np.arange(len(means)) * num_cells // len(means)
    drawn: Longs = rng.permutation(num_cells)[cells] // CELLS_PER_TURN
    return drawn
