"""The bound where each group has its layers whole or not at all: for small cases, to see how far
the linear programme is from what can be done.

Rule: every slice of a group has the same layers, in order, and a layer of slots that last is taken
up only with its snapshot, where a segment begins (or the play does).
"""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy.optimize import Bounds, LinearConstraint, milp

from codec.errors import InvalidError

from ..link.link import Link
from ..media import Media, segment_start
from ..qoe import QoeConfig
from ..session import SessionConfig
from .bound import Bound, search
from .feasible import open_play
from .groups import GROUP_S
from .offers import Offer, packet_bytes
from .relaxation import Relaxation, Solution

MOST_DECISIONS = 200
"""Groups times layers but layer 0."""


def mixed_bound(
    media: Media,
    link: Link,
    session_config: SessionConfig,
    qoe_config: QoeConfig,
    first_frame: int,
    until_frame: int,
    group_s: float = GROUP_S,
) -> Bound:
    """As `bound` says, of plays that keep the rule above. Takes seconds or minutes."""
    play = open_play(media, link, session_config, first_frame, until_frame)
    relaxation = Relaxation(play, qoe_config, group_s)
    return search(Mixed(relaxation).solve, relaxation)


class Mixed:
    """The mixed-integer programme of one play, for any waiting."""

    def __init__(self, relaxation: Relaxation) -> None:
        """Raises InvalidError where there is too much to decide."""
        self._relaxation = relaxation
        self._rows = relaxation.rows.copy()
        self._whole: dict[tuple[int, int], int] = {}  # variables of (layer, group)
        self._snapshot: dict[tuple[int, int], int] = {}
        self._closed: list[int] = []
        offers = relaxation.offers.offers
        for column, offer in zip(relaxation.columns.bought.tolist(), offers, strict=True):
            self._sort(column, offer)
        if len(self._whole) > MOST_DECISIONS:
            raise InvalidError(f"{len(self._whole)} decisions; the maximum is {MOST_DECISIONS}")
        for layer, number in self._whole:
            self._add_rules(layer, number)
        self._matrix = self._rows.matrix(relaxation.columns.count)

    def _sort(self, column: int, offer: Offer) -> None:
        relaxation, place = self._relaxation, (offer.layer, offer.group)
        if offer.whole:
            self._whole[place] = column
            return
        media = relaxation.play.media
        first = relaxation.grouping.groups[offer.group].first_frame
        if not offer.begins or (offer.group and first % media.segment_frames):
            self._closed.append(column)
            return
        # A snapshot is sent instead of the change of its frame.
        self._snapshot[place] = column
        sizes = media.sizes(segment_start(media, first))
        num_bytes = sizes.snapshot_bytes[offer.layer] - packet_bytes(sizes, offer.layer)
        for row in relaxation.bytes_rows(offer.group):
            self._rows.rows[row][column] = num_bytes / relaxation.unit_bytes

    def _add_rules(self, layer: int, number: int) -> None:
        column = self._whole[layer, number]
        if layer > 1:
            self._rows.add({column: 1.0, self._whole[layer - 1, number]: -1.0})
        if not self._relaxation.offers.must_begin:
            return
        before = {self._whole[layer, number - 1]: -1.0} if number else {}
        taken_up = self._snapshot.get((layer, number))
        if taken_up is None:
            self._rows.add({column: 1.0}, before)
        else:
            self._rows.add({column: 1.0}, before, {taken_up: -1.0})
            self._rows.add({taken_up: 1.0, column: -1.0})

    def solve(self, most_waiting_s: float) -> Solution:
        """The best of plays that wait so much or less."""
        relaxation = self._relaxation
        most, upper = relaxation.limits(most_waiting_s)
        most = np.concatenate([most, self._rows.most[len(most) :]])
        decisions = [*self._whole.values(), *self._snapshot.values()]
        upper[decisions], upper[self._closed] = 1.0, 0.0
        integrality = np.zeros(len(upper))
        integrality[decisions] = 1
        result: Any = milp(
            relaxation.cost,
            constraints=LinearConstraint(self._matrix, ub=most),
            bounds=Bounds(0.0, upper),
            integrality=integrality,
            options={"mip_rel_gap": 1e-6},
        )
        return relaxation.solution(result.x if result.status == 0 else None)
