"""The record of a playback for its report.

Rule: times come in as arguments. Memory is bounded: of frames, arrivals and moments the newest
MAX_ROWS are kept, of each kind, and what goes is counted.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from typing import Generic, TypeVar

from player.playout.timeline import FrameRecord
from player.source.source import Packets, SlicePackets
from server.abr.link import Link

MAX_ROWS = 1 << 17
"""More than an hour of frames at 30 a second; about 30 MB of each kind."""

STEPS_PER_S = 10
"""Moments per second at which the rates are recorded."""

WINDOW_STEPS = 5
"""Steps that goodput is a mean of."""

Row = TypeVar("Row")


class Rows(Generic[Row]):
    """The newest of what was added."""

    def __init__(self, most: int) -> None:
        self._rows: deque[Row] = deque(maxlen=most)
        self.dropped = 0

    def add(self, row: Row) -> None:
        self.dropped += len(self._rows) == self._rows.maxlen
        self._rows.append(row)

    def all(self) -> list[Row]:
        return list(self._rows)

    @property
    def last(self) -> Row | None:
        return self._rows[-1] if self._rows else None


@dataclass(frozen=True, slots=True)
class ShownFrame:
    record: FrameRecord
    drawn_s: float | None
    """When its picture was there; None when a newer frame was due by then."""


@dataclass(frozen=True, slots=True)
class Arrival:
    """Packets that came together."""

    play: int
    """Which of the plays, from 0 on: each loop and each seek begins one."""
    birth: int | None
    """Birth of the slice; None for snapshots."""
    frame: int | None
    """Frame of the snapshots; None for a slice."""
    first_layer: int
    layers: int
    wire_bytes: int
    came_s: float


@dataclass(slots=True)
class _Step:
    """Bytes received within one step of time."""

    number: int
    num_bytes: int
    ahead_s: float
    """Lead of a wall clock over the player's, which a pause stops, seconds."""


@dataclass(frozen=True, slots=True)
class Rates:
    """The network at a moment."""

    time_s: float
    goodput_bps: float
    """All bytes that were read in the last WINDOW_STEPS steps, over their time."""
    link_bps: float | None
    """Rate of the emulated link at this moment; None without one."""


class Journal:
    """Frames come from one thread, all that is received from another."""

    def __init__(self, most: int = MAX_ROWS) -> None:
        """most: rows of each kind; 0 notes nothing but the counts."""
        self.undrawn_frames = 0
        self.frames: Rows[ShownFrame] = Rows(most)
        self.arrivals: Rows[Arrival] = Rows(most)
        self._steps: Rows[_Step] = Rows(most)

    def shown(self, record: FrameRecord, drawn_s: float | None) -> None:
        """`record` was drawn at `drawn_s`, or skipped."""
        self.undrawn_frames += drawn_s is None
        self.frames.add(ShownFrame(record, drawn_s))

    def arrived(self, play: int, packets: Packets, now_s: float) -> None:
        self.arrivals.add(
            Arrival(
                play,
                packets.birth if isinstance(packets, SlicePackets) else None,
                None if isinstance(packets, SlicePackets) else packets.frame,
                packets.first_layer,
                len(packets.packets),
                packets.wire_bytes,
                now_s,
            )
        )

    def received(self, num_bytes: int, now_s: float, wall_s: float) -> None:
        """`num_bytes` were read from the network. wall_s: time.monotonic."""
        number, last = int(now_s * STEPS_PER_S), self._steps.last
        if last is not None and last.number >= number:
            last.num_bytes += num_bytes
        else:
            self._steps.add(_Step(number, num_bytes, wall_s - now_s))

    def rates(self, link: Link | None, link_began_s: float | None) -> list[Rates]:
        """One for each step from the first byte to the last. link_began_s: by time.monotonic."""
        steps = {step.number: step for step in self._steps.all()}
        if not steps:
            return []
        found, ahead_s = [], 0.0
        window: deque[int] = deque(maxlen=WINDOW_STEPS)
        for number in range(max(min(steps), max(steps) - MAX_ROWS), max(steps) + 1):
            step = steps.get(number)
            window.append(step.num_bytes if step else 0)
            ahead_s = step.ahead_s if step else ahead_s
            time_s = (number + 1) / STEPS_PER_S
            link_bps = None
            if link is not None and link_began_s is not None:
                link_bps = link.at(max(0.0, time_s + ahead_s - link_began_s)).rate_bps
            found.append(Rates(time_s, 8 * sum(window) * STEPS_PER_S / WINDOW_STEPS, link_bps))
        return found
