"""Policies for tests only: random ones, and plans made in advance."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from server.abr.decisioncontext import DecisionContext, Send, SendSlices, SendSnapshots
from server.abr.media import Media
from server.study.oracle.offers import Group


class Whims:
    """Sends at random anything allowed, useful or not."""

    mends = True

    def __init__(self, rng: np.random.Generator) -> None:
        self._rng = rng
        self._base = rng.uniform(0.2, 0.9)  # how often layer 0 is sent first
        self._idle = rng.choice([0.0, 0.0, 0.2])
        self._next_birth: int | None = None

    def choose(self, context: DecisionContext) -> Send | None:
        rng = self._rng
        if rng.random() < self._idle:
            return None
        if rng.random() < self._base:
            send = self._base_layer(context)
            if send is not None:
                return send
        return self._upper_layer(context)

    def _base_layer(self, context: DecisionContext) -> Send | None:
        """Layer 0 in order, sometimes with other layers."""
        media, first = context.media, context.clock.first_frame
        end_layer = int(self._rng.integers(1, media.num_layers + 1)) if self._whim(0.4) else 1
        birth = self._next_birth
        if birth is None:
            segments = first // media.segment_frames
            segment = int(self._rng.integers(segments + 1)) if self._whim(0.2) else segments
            self._next_birth = segment * media.segment_frames + 1
            return SendSnapshots(segment * media.segment_frames, 0, end_layer)
        end = min(context.end_birth, birth + int(self._rng.integers(1, 4)))
        if birth >= end:
            return None
        if birth % media.segment_frames == 0 and self._whim(0.3):
            self._next_birth = birth + 1
            return SendSnapshots(birth, 0, end_layer)
        self._next_birth = end
        return SendSlices(range(birth, end), 0, end_layer)

    def _upper_layer(self, context: DecisionContext) -> Send | None:
        media, holding, end = context.media, context.holding, context.end_birth
        layer = int(self._rng.integers(media.num_layers))
        birth = holding.end_birth(layer)
        if birth is not None and birth < end and self._whim(0.9):
            return SendSlices(range(birth, min(end, birth + 2)), layer, layer + 1)
        starts = range(0, end, media.segment_frames)
        start = starts[max(0, len(starts) - int(self._rng.integers(1, 4)))]
        return SendSnapshots(start, layer, layer + 1) if self._whim(0.2) else None

    def _whim(self, chance: float) -> bool:
        return bool(self._rng.random() < chance)


def planned_sends(
    media: Media, groups: Sequence[Group], num_layers: Sequence[int]
) -> list[list[Send]] | None:
    """Data that a plan sends for each frame, with complete slices in order; None if it starts a
    layer where that is not possible."""
    first, held = groups[0].first_frame, 0
    sends: list[list[Send]] = []
    for group, layers in zip(groups, num_layers, strict=True):
        for frame in range(group.first_frame, group.end_frame):
            start = frame - frame % media.segment_frames
            if layers > held and frame not in (start, first):
                return None
            # Layer 0 is last: a frame shows with it, and by then all other layers are there.
            sends.append([])
            if layers > max(held, 1):
                sends[-1].append(SendSnapshots(start, max(held, 1), layers))
                sends[-1].append(SendSlices(range(start + 1, frame + 1), max(held, 1), layers))
            if min(held, layers) > 1:
                sends[-1].append(SendSlices(range(frame, frame + 1), 1, min(held, layers)))
            if frame == first:
                sends[-1] += _cheapest_beginning(media, frame)
            elif frame == start and media.sizes(frame).snapshot_bytes[0] < _change(media, frame):
                sends[-1].append(SendSnapshots(frame, 0, 1))
            else:
                sends[-1].append(SendSlices(range(frame, frame + 1), 0, 1))
            held = layers
    return sends


def _change(media: Media, birth: int) -> float:
    return media.sizes(birth).layer_bytes[0]


def _cheapest_beginning(media: Media, frame: int) -> list[Send]:
    """The cheapest layer 0 up to `frame`, over the possible snapshots."""
    costs = {
        start: media.sizes(start).snapshot_bytes[0]
        + sum(_change(media, birth) for birth in range(start + 1, frame + 1))
        for start in range(0, frame + 1, media.segment_frames)
    }
    start = min(costs, key=lambda start: costs[start])
    return [SendSnapshots(start, 0, 1), SendSlices(range(start + 1, frame + 1), 0, 1)]


class Planned:
    """Sends complete slices in order, with the layers that a plan gives to their groups."""

    mends = False

    def __init__(self, media: Media, groups: Sequence[Group], num_layers: Sequence[int]) -> None:
        sends = planned_sends(media, groups, num_layers)
        assert sends is not None
        first = groups[0].first_frame
        self._left = [(frame, send) for frame, some in enumerate(sends, first) for send in some]
        self._left.reverse()

    def choose(self, context: DecisionContext) -> Send | None:
        if self._left and self._left[-1][0] < context.end_birth:
            return self._left.pop()[1]
        return None
