"""A frame shows only after a chain of layer 0 without a gap."""

from __future__ import annotations

from server.abr.decisioncontext import DecisionContext, Send, SendSlices, SendSnapshots
from server.abr.holding import Holding
from server.abr.link.link import Link, LinkStep
from server.abr.media import SegmentSizes
from server.study.simulate.simulator import simulate
from tests.support.delivery.media import MadeMedia


def stills() -> MadeMedia:
    """A stream in which nothing moves."""
    every = SegmentSizes((0.0,), (30.0,), (1000.0,), (0.0,))
    return MadeMedia((every,), num_frames=40, segment_frames=10)


def test_a_forgotten_chain_is_no_gap() -> None:
    holding = Holding(stills(), 0)
    holding.add_snapshots(0, 0, 1)
    for birth in range(1, 10):
        holding.add(birth, 0, 1)
    holding.add_snapshots(10, 0, 1)
    holding.forget(10)
    assert holding.end_frame == 11
    holding.add(11, 0, 1)
    assert holding.end_frame == 12


class Once:
    """Sends the first snapshot, and then all changes at once."""

    mends = False

    def __init__(self) -> None:
        self._left: list[Send] = [SendSlices(range(1, 40), 0, 1), SendSnapshots(0, 0, 1)]

    def choose(self, context: DecisionContext) -> Send | None:
        return self._left.pop() if self._left else None


def test_what_takes_no_bytes_comes() -> None:
    result = simulate(stills(), Once(), Link([LinkStep(1.0, 1e6, 0.02)]), at_most_s=20)
    assert [arrival.num_bytes for arrival in result.arrivals] == [1000.0, 0.0]
