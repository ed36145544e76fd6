"""Wasted bytes: packets that arrived and that no frame showed.

A packet shows in a frame if the client has it by then and can use it: its layer must show it,
behind a snapshot and all changes since, and all layers under it must show. What is sent twice shows
once.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from server.abr.decisioncontext import Send, SendSnapshots
from server.abr.holding import Holding
from server.abr.media import Media

from .simulator import Arrival, Shown

SLACK_S = 1e-9
"""The same as when frames take what has come."""


@dataclass(frozen=True, slots=True)
class Traffic:
    """All that came in a play."""

    came_bytes: float
    wasted_bytes: float

    @property
    def wasted_share(self) -> float:
        return self.wasted_bytes / self.came_bytes if self.came_bytes else 0.0


def measure_traffic(media: Media, arrivals: Sequence[Arrival], shown: Sequence[Shown]) -> Traffic:
    """arrivals: in the order in which they came; shown: frames one after another."""
    came_bytes = math.fsum(arrival.num_bytes for arrival in arrivals)
    used_bytes = math.fsum(_used_bytes(media, arrivals, shown))
    # Two sums of the same numbers differ in their last digits.
    wasted_bytes = came_bytes - used_bytes
    return Traffic(came_bytes, wasted_bytes if wasted_bytes > 1e-6 * came_bytes else 0.0)


@dataclass(slots=True)
class _Chain:
    """A chain of a layer as in `Holding`, with the packets that have not shown yet."""

    first: int
    last: int
    unseen: deque[tuple[int, float]]
    """(birth, bytes), in order of birth."""


class _Chains:
    """The chains of one layer."""

    def __init__(self) -> None:
        self._chains: list[_Chain] = []

    def add_change(self, birth: int, num_bytes: float) -> None:
        for chain in self._chains:
            if chain.last == birth - 1:
                chain.last = birth
                chain.unseen.append((birth, num_bytes))
                break
        self._join()

    def add_snapshot(self, frame: int, num_bytes: float) -> None:
        if not any(chain.first <= frame <= chain.last for chain in self._chains):
            self._chains.append(_Chain(frame, frame, deque([(frame, num_bytes)])))
            self._chains.sort(key=lambda chain: chain.first)

    def _join(self) -> None:
        chains = self._chains
        for n in range(len(chains) - 1, 0, -1):
            before, chain = chains[n - 1], chains[n]
            if before.last >= chain.first:
                before.last = max(before.last, chain.last)
                before.unseen = deque(sorted([*before.unseen, *chain.unseen]))
                del chains[n]

    def show(self, frame: int) -> Iterator[float]:
        """Bytes of the packets that `frame` is the first to show."""
        unseen = next(
            (chain.unseen for chain in reversed(self._chains) if chain.first <= frame), deque()
        )
        while unseen and unseen[0][0] <= frame:
            yield unseen.popleft()[1]

    def forget(self, frame: int) -> None:
        while len(self._chains) > 1 and self._chains[1].first <= frame:
            del self._chains[0]


def _used_bytes(
    media: Media, arrivals: Sequence[Arrival], shown: Sequence[Shown]
) -> Iterator[float]:
    """Bytes of each packet that showed."""
    layers = [_Chains() for _ in range(media.num_layers)]
    holding = Holding(media, shown[0].frame if shown else 0)
    coming = deque(arrivals)
    for one in shown:
        while coming and coming[0].time_s <= one.shown_s + SLACK_S:
            _take(media, coming.popleft().what, holding, layers)
        for chains, share in zip(layers, holding.shares(one.frame), strict=True):
            if share:
                yield from chains.show(one.frame)
            chains.forget(one.frame)
        holding.forget(one.frame)


def _take(media: Media, what: Send, holding: Holding, layers: list[_Chains]) -> None:
    what.add_to(holding)
    numbers = range(what.first_layer, what.end_layer)
    if isinstance(what, SendSnapshots):
        for layer in numbers:
            layers[layer].add_snapshot(what.frame, media.sizes(what.frame).snapshot_bytes[layer])
        return
    for birth in what.births:
        for layer in numbers:
            layers[layer].add_change(birth, media.sizes(birth).layer_bytes[layer])
