"""The linear programme behind the bound: groups of frames, one behind the other.

All times are turned into bytes that the link has passed by then. The bytes for the groups pass in
their order, none before its group may be sent, none after it is of use:

    done(g) >= max(done(g - 1), released(g)) + bytes(g),  done(g) <= due(g)

Both ends of these spans rise from group to group, and so this asks no more than that all bytes fit
into theirs. What they buy is in offers.py: frames of a layer, now or later. A layer shows no more
than those before it, and steps are those of qoe.py.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linprog
from scipy.sparse import csr_array

from bench.abr.feasible import Play, due_bytes, earliest_s, latest_s, waiting_s
from bench.abr.offers import Offers, group_frames, make_offers
from server.study.qoe import QoeConfig

Floats = NDArray[np.float64]
Row = dict[int, float]
"""Number of a variable -> what it is multiplied by."""


@dataclass(slots=True)
class SparseRows:
    """Rows that say: the products, summed up, are at most a number."""

    rows: list[Row] = field(default_factory=list)
    most: list[float] = field(default_factory=list)

    def add(self, *parts: Row, most: float = 0.0) -> None:
        """A row of `parts` that have no variable in common."""
        self.rows.append({place: factor for part in parts for place, factor in part.items()})
        self.most.append(most)

    def matrix(self, width: int) -> csr_array:
        """(rows, width) float64"""
        data = [factor for row in self.rows for factor in row.values()]
        places = [place for row in self.rows for place in row]
        starts = np.cumsum([0, *map(len, self.rows)])
        return csr_array((data, places, starts), shape=(len(self.rows), width))


class Columns:
    """Where each variable is; arrays of int64."""

    def __init__(self, upper: int, groups: int, offers: int, steps: int) -> None:
        """upper: layers but layer 0."""
        self.count = 0
        self.done = self._next(groups)
        """Bytes that have passed with the group, in units."""
        self.bought = self._next(offers)
        self.share = self._next(upper, groups)
        self.store = self._next(upper, groups)
        """Frames of the layer that are in store behind the group."""
        self.begun = self._next(upper, groups)
        """Keyframes of the layer that have come, up to 1."""
        self.step = self._next(steps)
        """Between a stretch and the next, dB."""

    def _next(self, *shape: int) -> NDArray[np.int64]:
        begin, self.count = self.count, self.count + int(np.prod(shape))
        return np.arange(begin, self.count, dtype=np.int64).reshape(shape)


@dataclass(frozen=True, slots=True)
class Solution:
    """The best of a programme; what is waited costs nothing here."""

    quality_db: float
    """Mean PSNR less what steps cost; -inf where nothing fits."""
    psnr_db: float


class Relaxation:
    """The programme of one play, for any waiting."""

    def __init__(self, play: Play, qoe_config: QoeConfig, group_s: float) -> None:
        self._play = play
        self._grouping = grouping = group_frames(play, qoe_config, group_s)
        self.cost_db = qoe_config.stall_db * play.media.fps / play.num_frames
        """Cost of a second of waiting, dB; the solutions do not include it."""
        self._offers: Offers = make_offers(play, grouping.groups)
        groups, first = grouping.groups, play.first_frame
        self._earliest_s = earliest_s(play)
        self._base_bytes = [
            sum(play.base_bytes[group.first_frame - first : group.end_frame - first])
            for group in groups
        ]
        self._unit_bytes = max(1.0, sum(self._base_bytes) / len(groups))
        self._columns = Columns(
            play.media.num_layers - 1,
            len(groups),
            len(self._offers.offers),
            grouping.num_stretches - 1,
        )
        self._rows = SparseRows()
        self._add_bytes()
        for upper in range(play.media.num_layers - 1):
            self._add_layer(upper)
        self._add_steps()
        self._matrix = self._rows.matrix(self._columns.count)
        self._cost = self._make_cost(qoe_config)  # (variables,) float64, dB

    @property
    def most_db(self) -> float:
        """Mean PSNR of all layers."""
        return sum(self._mean_db(layer) for layer in range(self._play.media.num_layers))

    @property
    def least_s(self) -> float:
        """Least waiting of any play."""
        return waiting_s(self._play, self._earliest_s[-1])

    def _mean_db(self, layer: int) -> float:
        """Gain in mean PSNR of a layer that is shown in every frame."""
        groups = self._grouping.groups
        total_db = sum(group.num_frames * group.sizes.gains_db[layer] for group in groups)
        return total_db / self._play.num_frames

    def _add_bytes(self) -> None:
        """The first rows, one for each group and then one more; `_limits` says what they are at
        most."""
        bought: list[Row] = [{} for _ in self._grouping.groups]
        for column, offer in zip(self._columns.bought.tolist(), self._offers.offers, strict=True):
            bought[offer.group][column] = offer.num_bytes / self._unit_bytes
        done = self._columns.done.tolist()
        for number, row in enumerate(bought):
            self._rows.add({done[number]: -1.0}, row)
        for number, row in enumerate(bought):
            before = {done[number - 1]: 1.0} if number else {}
            self._rows.add({done[number]: -1.0}, before, row)

    def _add_layer(self, upper: int) -> None:
        """Constraint: the bought frames of layer upper + 1 are shown or in store."""
        groups, columns = self._grouping.groups, self._columns
        bought: list[Row] = [{} for _ in groups]
        begins: list[Row] = [{} for _ in groups]
        for column, offer in zip(columns.bought.tolist(), self._offers.offers, strict=True):
            if offer.layer == upper + 1:
                bought[offer.group][column] = -offer.frames
                if offer.begins:
                    begins[offer.group][column] = -offer.begins
        share, store = columns.share.tolist(), columns.store[upper].tolist()
        begun = columns.begun[upper].tolist()
        for number, group in enumerate(groups):
            shows = share[upper][number]
            before = {store[number - 1]: -1.0} if number else {}
            row: Row = {shows: float(group.num_frames), store[number]: 1.0}
            self._rows.add(row, before, bought[number])
            if upper:
                self._rows.add({shows: 1.0, share[upper - 1][number]: -1.0})
            before = {begun[number - 1]: -1.0} if number else {}
            self._rows.add({begun[number]: 1.0}, before, begins[number])
            self._rows.add({shows: 1.0, begun[number]: -1.0})

    def _add_steps(self) -> None:
        """A step is at least the difference of what two stretches lack of all layers, either
        way."""
        means: list[Row] = [{} for _ in range(self._grouping.num_stretches)]
        fixed_db = [0.0] * len(means)
        for number, group in enumerate(self._grouping.groups):
            if group.stretch is None:
                continue
            gains_db = group.sizes.gains_db
            weight = group.num_frames / self._grouping.stretch_frames
            fixed_db[group.stretch] -= weight * sum(gains_db[1:])
            for column, gain_db in zip(self._columns.share[:, number], gains_db[1:], strict=True):
                means[group.stretch][int(column)] = weight * gain_db
        for number, column in enumerate(self._columns.step.tolist()):
            difference_db = fixed_db[number + 1] - fixed_db[number]
            for sign in (1.0, -1.0):
                after = {place: sign * factor for place, factor in means[number + 1].items()}
                before = {place: -sign * factor for place, factor in means[number].items()}
                self._rows.add(after, before, {column: -1.0}, most=-sign * difference_db)

    def _make_cost(self, config: QoeConfig) -> Floats:
        cost = np.zeros(self._columns.count)
        for number, group in enumerate(self._grouping.groups):
            share = group.num_frames / self._play.num_frames
            cost[self._columns.share[:, number]] = -share * np.array(group.sizes.gains_db[1:])
        cost[self._columns.step] = config.switch_db / max(1, len(self._columns.step))
        return cost

    def _limits(self, most_waiting_s: float) -> tuple[Floats, Floats]:
        """(most of each row, most of each variable) for plays that wait so much or less."""
        play, groups, columns = self._play, self._grouping.groups, self._columns
        latest = latest_s(play, most_waiting_s)
        most, upper = np.array(self._rows.most), np.ones(columns.count)
        upper[columns.bought] = upper[columns.step] = np.inf
        upper[columns.store] = np.reshape(self._offers.stores, columns.store.shape)
        due = 0.0
        for number, group in enumerate(groups):
            ahead = group.first_frame - play.first_frame - play.lead_frames
            released = play.passage.bytes_by(self._earliest_s[ahead]) if ahead >= 0 else 0.0
            # What comes too late for the group before counts for this one, as what is its own does.
            released = min(released, due)
            due = max(due, due_bytes(play, latest[group.end_frame - 1 - play.first_frame]))
            upper[columns.done[number]] = (due + self._offers.spare_bytes) / self._unit_bytes
            most[number] = -(self._base_bytes[number] + released) / self._unit_bytes
            most[len(groups) + number] = -self._base_bytes[number] / self._unit_bytes
        return most, upper

    def solve(self, most_waiting_s: float) -> Solution:
        """The best of plays that wait so much or less."""
        most, upper = self._limits(most_waiting_s)
        bounds = np.stack([np.zeros_like(upper), upper], axis=1)
        result: Any = linprog(self._cost, self._matrix, most, bounds=bounds, method="highs")
        if result.status != 0:
            return Solution(-np.inf, -np.inf)
        values: Floats = result.x
        steps_db = float(self._cost[self._columns.step] @ values[self._columns.step])
        quality_db = self._mean_db(0) - float(self._cost @ values)
        return Solution(quality_db, quality_db + steps_db)
