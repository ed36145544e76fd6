"""Leases: which slots go on with the same decoded parameters, in which layer each is, and what
leaves the trainer.

Most of a scene stands still, so most slots of a slice are kept: they are not trained, not sent, and
shown with exactly the values that a player has. The active slots are chosen anew at the
beginning of every window by what changed in its newest frame.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from codec.arrays import Bytes, Doubles, Flags, Floats, Ints, Longs
from codec.errors import InvalidError
from codec.lattice.forms import interleave
from codec.lattice.lattice import States, dequantise, quantise
from codec.slots.slotlayout import ENDED, KEPT, NEW, PREDICTED, SlotLayout, Update
from codec.splats import Splats

from .takeover import NEAR_STEPS, PlayerState

TRADE_SHARE = 0.001
"""Share of a slice's slots that may swap with a slot of a higher layer that contributes much
more. Both slots are sent anew, so a swap costs twice as much as a new Gaussian."""

TRADE_GAIN = 4.0
"""How many times as much a Gaussian of a higher layer must contribute to be worth a trade."""

LEAST_SHOWN = 1 / 255
"""Opacity below which recipe v1 draws nothing."""


HORIZON_FRAMES = 30
"""Frames in which what was spent too much, or too little, is made good."""

FIRST_SLOT_BYTES = 5.0
"""Size of an active slot while no slice has been measured."""

MEMORY = 0.8
"""How much the price of a slot stays that of the slices before, from slice to slice."""


@dataclass(frozen=True)
class LeaseConfig:
    """How much of a slice is trained and sent; players keep the rest."""

    active_share: float = 0.3
    """Share of a slice's slots that is trained and sent; 1 sends all."""
    refresh_share: float = 0.02
    """Share of a slice's slots that is always trained, oldest leases first, so that still parts of
    a scene continue to learn."""
    hold: float = 0.75
    """Largest change of a value, in quantisation steps, that is not sent: 0.5 rounds to the nearest
    step; more makes the stream smaller and coarser."""
    bytes_per_frame: float | None = None
    """Mean number of bytes that a frame may take, the first frame excluded; active_share is then
    the largest share of a slice. Unlimited by default."""

    def __post_init__(self) -> None:
        for name in ("active_share", "refresh_share"):
            if not 0 <= getattr(self, name) <= 1:
                raise InvalidError(f"{name} {getattr(self, name):g}: choose 0 to 1")
        if self.bytes_per_frame is not None and not self.bytes_per_frame > 0:
            raise InvalidError(f"bytes_per_frame {self.bytes_per_frame:g}: choose more than 0")
        if not 0.5 <= self.hold <= 4:
            raise InvalidError(f"hold {self.hold:g}: choose 0.5 to 4")


class ByteBudget:
    """The price of an active slot, and what is owed."""

    def __init__(self, bytes_per_frame: float) -> None:
        self.bytes_per_frame = bytes_per_frame
        self._state = np.array([FIRST_SLOT_BYTES, 0.0])  # price, owed bytes

    @property
    def slots(self) -> int:
        """How many slots the next slice may have active."""
        price, owed = self._state
        return max(0, int((self.bytes_per_frame - owed / HORIZON_FRAMES) / price))

    def record_sent_bytes(self, num_bytes: int, slots: int) -> None:
        """A slice with so many active slots took `num_bytes`."""
        if slots:
            price = num_bytes / slots
            self._state[0] = max(MEMORY * self._state[0] + (1 - MEMORY) * price, 1e-3)
        self._state[1] += num_bytes - self.bytes_per_frame
        # A quiet minute must not pay for a wild one: that would overfill a link.
        self._state[1] = max(self._state[1], -HORIZON_FRAMES * self.bytes_per_frame / 2)

    def state(self) -> Doubles:
        """The numbers that change; a view."""
        return self._state


class Leases:
    """The value of every slot in a player, and since when."""

    def __init__(self, config: LeaseConfig, layout: SlotLayout) -> None:
        self.config, self.slots, self.lattices = config, layout.slots, layout.lattices
        self.slice_size = layout.num_slots
        num_gs = layout.swin_size * self.slice_size
        pattern = np.repeat(np.arange(layout.num_layers), self.slots)
        self.layers = np.tile(pattern, layout.swin_size).astype(np.uint8)
        """(num_gs,) the layer of each slot; in genesis of each Gaussian."""
        self.states = States.zeros(num_gs, layout.sh_degree)
        self.is_shown = np.zeros(num_gs, np.bool_)
        """Whether a slot holds a Gaussian."""
        self.is_other = np.ones(num_gs, np.bool_)
        """Whether what is trained in a slot is another Gaussian than the one a player has."""
        self.trained = np.zeros(num_gs, np.int32)
        """The birth that each slot was active at last."""
        self.budget = ByteBudget(config.bytes_per_frame) if config.bytes_per_frame else None

    def state(self) -> dict[str, npt.NDArray[Any]]:
        """Everything that changes while training. Views, not copies."""
        arrays: dict[str, npt.NDArray[Any]] = {
            "lease_layers": self.layers,
            "lease_positions": self.states.positions,
            "lease_attributes": self.states.attributes,
            "lease_is_shown": self.is_shown,
            "lease_is_other": self.is_other,
            "lease_trained": self.trained,
        }
        if self.budget is not None:
            arrays["lease_budget"] = self.budget.state()
        return arrays

    def rank(self, contributions: Doubles) -> None:
        """Puts each Gaussian of genesis into a layer, those that contribute most into the first."""
        lanes = len(self.layers) // self.slice_size
        sizes = [lanes * slots for slots in self.slots]
        most_first = np.argsort(-contributions, kind="stable")
        self.layers[most_first] = np.repeat(np.arange(len(sizes)), sizes)

    def deal(self, means: Floats, rng: np.random.Generator) -> Longs:
        """Ends genesis: the order that puts each Gaussian into a slot of its layer. Row i becomes
        what row order[i] was.

        Lanes are dealt at random. In each layer of a lane the Gaussians lie along a Morton curve,
        so that neighbours in space are neighbours in their packets.
        """
        lanes = len(self.layers) // self.slice_size
        low = means.min(axis=0)
        extent = max(float((means.max(axis=0) - low).max()), 1e-6)
        codes = interleave(((means - low) * (((1 << 16) - 1) / extent)).astype(np.int64))
        order = np.empty(len(means), np.int64)
        at = 0
        for layer, slots in enumerate(self.slots):
            mine = rng.permutation(np.flatnonzero(self.layers == layer))
            for lane in range(lanes):
                rows = mine[lane * slots : (lane + 1) * slots]
                first = lane * self.slice_size + at
                order[first : first + slots] = rows[np.argsort(codes[rows], kind="stable")]
            at += slots
        self.layers[:] = self.layers[order]
        return order

    def choose(self, rows: Ints, scores: Doubles, by_layer: bool = False) -> Ints:
        """The `rows`, slots of one slice, that are to be active. scores: (len(rows),) how
        much each has to do with what changed. by_layer: as large a share of each layer; otherwise
        the first one, which contributes most, takes half of them."""
        count = len(rows)
        wanted = round(self.config.active_share * count)
        if self.budget is not None:
            wanted = min(wanted, self.budget.slots)
        turn = min(round(self.config.refresh_share * count), wanted)
        by_score = np.argsort(-scores, kind="stable")
        chosen = np.zeros(count, np.bool_)
        layers = self.layers[rows][by_score] * np.uint8(by_layer)
        ends = np.cumsum(np.bincount(layers)) * ((wanted - turn) / max(count, 1))
        for layer, quota in enumerate(np.diff(np.rint(ends).astype(np.int64), prepend=0)):
            chosen[by_score[layers == layer][:quota]] = True
        chosen &= scores > 0
        # Of what shows, those that have been kept for longest.
        age = np.where(chosen | (scores <= 0), np.iinfo(np.int32).max, self.trained[rows])
        oldest = np.argsort(age, kind="stable")[:turn]
        chosen[oldest] = age[oldest] < np.iinfo(np.int32).max
        return rows[chosen]

    def least(self, rows: Ints, contributions: Floats, share: float) -> Ints:
        """The `share` of each layer that contributes least among `rows`, slots of one slice."""
        least_first = rows[np.argsort(contributions, kind="stable")]
        layers = self.layers[least_first]
        parts = [
            least_first[layers == layer][: round(share * slots)]
            for layer, slots in enumerate(self.slots)
        ]
        return np.concatenate(parts).astype(np.int32)

    def trades(self, rows: Ints, contributions: Floats) -> tuple[Ints, Ints]:
        """Pairs of `rows`, the slots of one slice, that had better change places: the first of each
        lies in a lower layer than the second, which contributes over TRADE_GAIN times as much. At
        most TRADE_SHARE of the slice, those that gain most first."""
        most = round(TRADE_SHARE * len(rows))
        low, high = (np.zeros(0, np.int32) for _ in range(2))
        layers = self.layers[rows]
        for layer in range(len(self.slots) - 1):
            below, above = np.flatnonzero(layers == layer), np.flatnonzero(layers > layer)
            above = above[~np.isin(rows[above], high)]
            count = min(most - len(low), len(below), len(above))
            least = below[np.argsort(contributions[below], kind="stable")[:count]]
            best = above[np.argsort(-contributions[above], kind="stable")[:count]]
            worth = contributions[best] > TRADE_GAIN * contributions[least]
            worth &= self.is_shown[rows[best]]
            low = np.concatenate([low, rows[least[worth]]])
            high = np.concatenate([high, rows[best[worth]]])
        return low.astype(np.int32), high.astype(np.int32)

    def held(self, birth: int, lane: slice, start_offsets: Bytes, splats: Splats) -> PlayerState:
        """A player's slots of `lane` from `birth` on, whose next life has not begun. splats: as
        they are drawn."""
        states = self.states.take(lane).copy()
        shows, escaped = self.is_shown[lane].copy(), self.is_other[lane] & self.is_shown[lane]
        return PlayerState(birth, states, shows, escaped, start_offsets, splats)

    def mature(
        self,
        birth: int,
        lane: slice,
        is_active: Flags,
        splats: Splats,
        start_offsets: Ints,
        other: tuple[Flags, PlayerState] | None = None,
    ) -> tuple[Update, Splats]:
        """The update of the slice born at `birth`, whose trained Gaussians are `splats`;
        and those with the values that a player has from now on.

        lane, is_active, splats, start_offsets: of all slots of the lane, of which only the active
        ones have been trained. other: which of the slots are given what they hold, and that; they
        are not active.
        """
        statuses = np.full(len(splats), KEPT, np.uint8)
        decoded = [array.copy() for array in splats.arrays]
        held = self.states.take(lane)
        escaped = np.zeros(len(splats), np.bool_)
        layers = self.layers[lane]
        is_shown, is_other = self.is_shown[lane], self.is_other[lane]
        for layer, lattice in enumerate(self.lattices):
            mine = is_active & (layers == layer)
            for rows, continues in (
                (np.flatnonzero(mine & ~is_other & is_shown), True),
                (np.flatnonzero(mine & (is_other | ~is_shown)), False),
            ):
                before = held.take(rows) if continues else None
                states, fit = quantise(splats.take(rows), lattice, before, self.config.hold)
                shows = states.attributes[:, -1] >= LEAST_SHOWN * (lattice.opacity_levels - 1)
                status = np.full(len(rows), PREDICTED if continues else NEW, np.uint8)
                if before is not None:
                    status[~states.differ(before) & (start_offsets[rows] == 0)] = KEPT
                status[~fit] = NEW
                status[~shows] = np.where(is_shown[rows[~shows]], ENDED, KEPT)
                statuses[rows] = status
                exact = dequantise(states, lattice)
                for array, of_lattice in zip(decoded, exact.arrays, strict=True):
                    array[rows[fit]] = of_lattice[fit]
                held.put(rows, states)
                is_shown[rows] = shows
                escaped[rows] = ~fit
        if other is not None:
            follows, theirs = other
            is_active = is_active | follows
            self._follow(np.flatnonzero(follows), theirs, statuses, held, is_shown, is_other)
            for array, exact_array in zip(decoded, theirs.splats.arrays, strict=True):
                array[follows] = exact_array[follows]
            escaped[follows] = (theirs.escaped & theirs.shows)[follows]
            start_offsets = np.where(follows, theirs.start_offsets, start_offsets)
        self.states.put(np.arange(lane.start, lane.stop), held)
        # Views: the flags of the lane.
        is_other[is_active] = escaped[is_active]  # nothing is predicted from those
        self.trained[lane][is_active] = birth
        sent = np.flatnonzero(statuses >= PREDICTED)
        exact = Splats(*decoded)
        update = Update(
            birth, statuses, held.take(sent), start_offsets[sent].astype(np.uint8), escaped[sent],
            exact.take(sent[escaped[sent]]),
        )  # fmt: skip
        return update, exact

    def _follow(
        self,
        rows: Longs,
        theirs: PlayerState,
        statuses: Bytes,
        held: States,
        is_shown: Flags,
        is_other: Flags,
    ) -> None:
        """Makes `rows` of a lane what they are to hold: fills in their statuses, and what is held
        of them."""
        before, after = held.take(rows), theirs.states.take(rows)
        was_shown, shows = is_shown[rows], theirs.shows[rows]
        steps = np.abs(after.numbers() - before.numbers()).max(axis=1)
        goes_on = was_shown & shows & ~is_other[rows] & ~theirs.escaped[rows]
        goes_on &= (steps <= NEAR_STEPS) & (theirs.start_offsets[rows] == 0)
        status = np.where(goes_on, np.where(steps > 0, PREDICTED, KEPT), NEW)
        status[~shows] = np.where(was_shown[~shows], ENDED, KEPT)
        statuses[rows] = status
        held.put(rows, after)
        is_shown[rows] = shows
