"""Plays without decoding and drawing: only the network and the clock."""

from __future__ import annotations

from dataclasses import dataclass

from player.playout.clock import Clock
from player.playout.queues import Events
from player.playout.threads import Threads
from player.playout.timeline import FrameRecord, Playout, PlayoutTotals
from player.source.source import Packets, Source
from server.abr.playout import PlayoutConfig

WINDOW = PlayoutConfig(conceal_s=0.15)
"""The playout configuration of a window."""


@dataclass(frozen=True)
class Watched:
    """Result of one play."""

    frames: list[FrameRecord]
    totals: PlayoutTotals
    startup_s: float
    """Time from the first request for packets to the first picture."""
    packets: list[Packets]
    """Packets in order of arrival."""

    def layers(self, begin_s: float = 0.0, end_s: float = 1e9) -> float:
        """Mean layers of the frames shown from begin_s to end_s after the first picture."""
        first_s = self.frames[0].shown_s
        shown = [one.layers for one in self.frames if begin_s <= one.shown_s - first_s < end_s]
        return sum(shown) / len(shown)


def watched(source: Source, until_frame: int | None = None) -> Watched:
    """Plays `source` in real time, like a window, to its end or to `until_frame`; closes it."""
    clock, frames, packets = Clock(real=True), list[FrameRecord](), list[Packets]()
    needed = 1 if source.adaptive else source.num_layers
    playout = Playout(
        source.manifest,
        source.frames.first,
        source.frames.end,
        config=WINDOW,
        needed=needed,
    )
    events = Events(playout, clock, lambda one, came_s: packets.append(one))
    began_s = clock.now_s()
    try:
        with Threads(source, events):
            while (due := events.wait_for_frame()) is not None:
                frames.append(due.record)
                if due.record.frame + 1 == until_frame:
                    break
    finally:
        source.close()
    return Watched(frames, events.totals, frames[0].shown_s - began_s, packets)
