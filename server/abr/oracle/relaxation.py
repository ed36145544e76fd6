"""The linear programme behind the bound: groups of frames, one behind the other.

All times are turned into bytes that the link has passed by then. The bytes for the groups pass in
their order, none before its group may be sent, none after it is of use:

    done(g) >= max(done(g - 1), released(g)) + bytes(g),  done(g) <= due(g)

Both ends of these spans rise from group to group, and so this asks no more than that all bytes fit
into theirs. What they buy is in offers.py: frames of a layer, now or later. A layer shows no more
than those before it, and steps are those of qoe.py.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.optimize import linprog

from ..qoe import QoeConfig
from .columns import Columns
from .feasible import Play, due_bytes, earliest_s, latest_s, waiting_s
from .groups import group_frames
from .offers import Offers
from .sliceoffers import slice_offers
from .slotoffers import slot_offers
from .sparserows import Floats, Row, SparseRows


@dataclass(frozen=True, slots=True)
class Solution:
    """The best of a programme; what is waited costs nothing here."""

    quality_db: float
    """Mean PSNR less what steps cost; -inf where nothing fits."""
    psnr_db: float
    shares: Floats
    """(layers - 1, groups) float64: how much of each layer but layer 0 shows."""


class Relaxation:
    """The programme of one play, for any waiting."""

    def __init__(self, play: Play, qoe_config: QoeConfig, group_s: float) -> None:
        self.play = play
        self.grouping = grouping = group_frames(play, qoe_config, group_s)
        self.cost_db = qoe_config.stall_db * play.media.fps / play.num_frames
        """What a second of waiting costs, dB; no solution counts it."""
        make_offers = slot_offers if play.media.has_slots else slice_offers
        self.offers: Offers = make_offers(play, grouping.groups)
        groups, first = grouping.groups, play.first_frame
        self._earliest_s = earliest_s(play)
        self._base_bytes = [
            sum(play.base_bytes[group.first_frame - first : group.end_frame - first])
            for group in groups
        ]
        self.unit_bytes = max(1.0, sum(self._base_bytes) / len(groups))
        self.columns = Columns(
            play.media.num_layers - 1,
            len(groups),
            len(self.offers.offers),
            grouping.num_stretches - 1,
            self.offers.must_begin,
        )
        self.rows = SparseRows()
        self._add_bytes()
        for upper in range(play.media.num_layers - 1):
            self._add_layer(upper)
        self._add_steps()
        self._matrix = self.rows.matrix(self.columns.count)
        self.cost = self._cost(qoe_config)  # (variables,) float64, dB

    @property
    def most_db(self) -> float:
        """Mean PSNR of all layers."""
        return sum(self._mean_db(layer) for layer in range(self.play.media.num_layers))

    @property
    def least_s(self) -> float:
        """What is waited in any play, at least."""
        return waiting_s(self.play, self._earliest_s[-1])

    def _mean_db(self, layer: int) -> float:
        """What a layer adds to the mean PSNR if it always shows."""
        groups = self.grouping.groups
        total_db = sum(group.num_frames * group.sizes.gains_db[layer] for group in groups)
        return total_db / self.play.num_frames

    def bytes_rows(self, number: int) -> tuple[int, int]:
        """The numbers of the rows that hold the bytes of a group."""
        return number, len(self.grouping.groups) + number

    def _add_bytes(self) -> None:
        """The first two rows of each group; `limits` fills in what they are at most."""
        bought: list[Row] = [{} for _ in self.grouping.groups]
        for column, offer in zip(self.columns.bought.tolist(), self.offers.offers, strict=True):
            bought[offer.group][column] = offer.num_bytes / self.unit_bytes
        done = self.columns.done.tolist()
        for number, row in enumerate(bought):
            self.rows.add({done[number]: -1.0}, row)
        for number, row in enumerate(bought):
            before = {done[number - 1]: 1.0} if number else {}
            self.rows.add({done[number]: -1.0}, before, row)

    def _add_layer(self, upper: int) -> None:
        """What is bought of layer upper + 1 shows or is in store."""
        groups, columns = self.grouping.groups, self.columns
        bought: list[Row] = [{} for _ in groups]
        begins: list[Row] = [{} for _ in groups]
        for column, offer in zip(columns.bought.tolist(), self.offers.offers, strict=True):
            if offer.layer == upper + 1:
                bought[offer.group][column] = -offer.frames
                if offer.begins:
                    begins[offer.group][column] = -offer.begins
        share, store = columns.share.tolist(), columns.store[upper].tolist()
        for number, group in enumerate(groups):
            shows = share[upper][number]
            before = {store[number - 1]: -1.0} if number else {}
            row: Row = {shows: float(group.num_frames), store[number]: 1.0}
            self.rows.add(row, before, bought[number])
            if upper:
                self.rows.add({shows: 1.0, share[upper - 1][number]: -1.0})
            if self.offers.must_begin:
                begun = columns.begun[upper].tolist()
                before = {begun[number - 1]: -1.0} if number else {}
                self.rows.add({begun[number]: 1.0}, before, begins[number])
                self.rows.add({shows: 1.0, begun[number]: -1.0})

    def _add_steps(self) -> None:
        """A step is at least the difference of two stretches, either way."""
        means: list[Row] = [{} for _ in range(self.grouping.num_stretches)]
        fixed_db = [0.0] * len(means)
        for number, group in enumerate(self.grouping.groups):
            if group.stretch is None:
                continue
            weight, gains_db = group.num_frames / self.grouping.stretch_frames, group.sizes.gains_db
            fixed_db[group.stretch] += weight * gains_db[0]
            for column, gain_db in zip(self.columns.share[:, number], gains_db[1:], strict=True):
                means[group.stretch][int(column)] = weight * gain_db
        for number, column in enumerate(self.columns.step.tolist()):
            difference_db = fixed_db[number + 1] - fixed_db[number]
            for sign in (1.0, -1.0):
                after = {place: sign * factor for place, factor in means[number + 1].items()}
                before = {place: -sign * factor for place, factor in means[number].items()}
                self.rows.add(after, before, {column: -1.0}, most=-sign * difference_db)

    def _cost(self, config: QoeConfig) -> Floats:
        cost = np.zeros(self.columns.count)
        for number, group in enumerate(self.grouping.groups):
            share = group.num_frames / self.play.num_frames
            cost[self.columns.share[:, number]] = -share * np.array(group.sizes.gains_db[1:])
        cost[self.columns.step] = config.switch_db / max(1, len(self.columns.step))
        return cost

    def limits(self, most_waiting_s: float) -> tuple[Floats, Floats]:
        """(most of each row, most of each variable) for plays that wait so much or less."""
        play, groups, columns = self.play, self.grouping.groups, self.columns
        latest = latest_s(play, most_waiting_s)
        most, upper = np.array(self.rows.most), np.ones(columns.count)
        upper[columns.bought] = upper[columns.step] = np.inf
        upper[columns.store] = np.reshape(self.offers.stores, columns.store.shape)
        due = 0.0
        for number, group in enumerate(groups):
            ahead = group.first_frame - play.first_frame - play.lead_frames
            released = play.passage.bytes_by(self._earliest_s[ahead]) if ahead >= 0 else 0.0
            # What comes too late for the group before counts for this one, as what is its own does.
            released = min(released, due)
            due = max(due, due_bytes(play, latest[group.end_frame - 1 - play.first_frame]))
            upper[columns.done[number]] = (due + self.offers.spare_bytes) / self.unit_bytes
            free_row, next_row = self.bytes_rows(number)
            most[free_row] = -(self._base_bytes[number] + released) / self.unit_bytes
            most[next_row] = -self._base_bytes[number] / self.unit_bytes
        return most, upper

    def solve(self, most_waiting_s: float) -> Solution:
        """The best of plays that wait so much or less."""
        most, upper = self.limits(most_waiting_s)
        bounds = np.stack([np.zeros_like(upper), upper], axis=1)
        result: Any = linprog(self.cost, self._matrix, most, bounds=bounds, method="highs")
        return self.solution(result.x if result.status == 0 else None)

    def solution(self, values: Floats | None) -> Solution:
        """What `values` of the variables say; None if there are none."""
        if values is None:
            return Solution(-np.inf, -np.inf, np.zeros(self.columns.share.shape))
        steps_db = float(self.cost[self.columns.step] @ values[self.columns.step])
        quality_db = self._mean_db(0) - float(self.cost @ values)
        return Solution(quality_db, quality_db + steps_db, values[self.columns.share])
