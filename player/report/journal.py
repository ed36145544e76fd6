"""The record of a playback, of frames, arrivals and sound, and its summary: for people, and as a
JSON file for tools.

Rule: times come in as arguments. Memory is bounded: of frames, arrivals and moments the newest
MAX_ROWS are kept, of each kind, and what goes is counted.
"""

from __future__ import annotations

import json
from collections import deque
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any, Generic, TypeVar

from codec.files import write_atomic
from player.playout.timeline import FrameRecord, PlayoutTotals
from player.source.source import Packets, SlicePackets
from server.abr.link import Link


@dataclass(slots=True)
class SoundCounts:
    """Amounts of sound received, decoded and missing in a playback."""

    received_bytes: int = 0
    """Bytes of the objects of sound."""
    segments: int = 0
    """Segments that were decoded."""
    failed_segments: int = 0
    """Segments that could not be fetched or decoded, and were silent."""
    missing_s: float = 0.0
    """Seconds of silence because a segment had not arrived yet."""


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
    """Birth of the slice; None for keyframes."""
    frame: int | None
    """Frame of the keyframes; None for a slice."""
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


MAX_PLAYS = 1000
"""Plays that are kept apart; of those before only the sums are kept."""


@dataclass(frozen=True, slots=True)
class PlayedOnce:
    """One play: each loop and each seek begins one."""

    asked_s: float
    """When the player asked for the stream, seconds on its clock."""
    totals: PlayoutTotals

    @property
    def startup_s(self) -> float:
        """From the request to the first picture; 0 when none came."""
        return max(0.0, self.totals.startup_s - self.asked_s) if self.totals.frames else 0.0


@dataclass(slots=True)
class PlaySummary:
    """How a playback went. Times are seconds since the player asked for the stream first."""

    source: str = ""
    renderer: str = "nothing"
    fps: float = 0.0
    plays: deque[PlayedOnce] = field(default_factory=lambda: deque(maxlen=MAX_PLAYS))
    """The newest."""
    num_plays: int = 0
    preparing_s: float = 0.0
    """Time before that to make decoder and renderer ready, seconds."""
    received_bytes: int = 0
    uploaded_bytes: int = 0
    link: Link | None = None
    link_began_s: float | None = None
    """By time.monotonic."""
    link_bytes: int | None = None
    """Bytes that came over `--link`; None without it."""
    sound: SoundCounts | None = None
    """Counters of the sound; None without sound."""
    interrupted: bool = False
    journal: Journal = field(default_factory=Journal)
    _before: PlayoutTotals = field(default_factory=PlayoutTotals)

    def add_play(self, play: PlayedOnce) -> None:
        """One more play."""
        if len(self.plays) == MAX_PLAYS:
            self._before.add(self.plays[0].totals, self.plays[0].startup_s)
        self.plays.append(play)
        self.num_plays += 1

    @property
    def totals(self) -> PlayoutTotals:
        """Totals of all plays: sums, and the maximum of each maximum."""
        found = PlayoutTotals()
        found.add(self._before, self._before.startup_s)
        for play in self.plays:
            found.add(play.totals, play.startup_s)
        return found

    def lines(self) -> list[str]:
        """The summary for people."""
        totals = self.totals
        return [
            f"{totals.frames} frames of {self.source}, drawn by {self.renderer}",
            f"startup {totals.startup_s:.3f} s, {totals.stalls} stalls, "
            f"{totals.stalled_s:.3f} s stalled, {totals.concealed} frames concealed",
            f"{totals.mean_layers:.2f} layers on average, at least {totals.fewest_layers or 0}; "
            f"{totals.wire_bytes} bytes in packets; {totals.late_packets} packets came late",
        ]

    def to_json(self) -> dict[str, Any]:
        totals, journal = self.totals, self.journal
        return {
            "source": self.source,
            "renderer": self.renderer,
            "fps": self.fps,
            "interrupted": self.interrupted,
            "totals": {
                "plays": self.num_plays,
                "frames": totals.frames,
                "undrawn_frames": journal.undrawn_frames,
                "preparing_s": self.preparing_s,
                "startup_s": totals.startup_s,
                "stalls": totals.stalls,
                "stalled_s": totals.stalled_s,
                "concealed": totals.concealed,
                "mean_layers": totals.mean_layers,
                "fewest_layers": totals.fewest_layers,
                "bytes": totals.wire_bytes,
                "received_bytes": self.received_bytes,
                "uploaded_bytes": self.uploaded_bytes,
                "link_bytes": self.link_bytes,
                "late_packets": totals.late_packets,
                "most_frames_waiting": totals.most_frames_waiting,
                "most_bytes_waiting": totals.most_bytes_waiting,
            },
            "sound": None if self.sound is None else asdict(self.sound),
            "plays": [
                {"asked_s": play.asked_s, "startup_s": play.startup_s} for play in self.plays
            ],
            "frames": [
                {
                    "play": shown.record.play,
                    "frame": shown.record.frame,
                    "layers": shown.record.layers,
                    "due_s": shown.record.due_s,
                    "shown_s": shown.record.shown_s,
                    "drawn_s": shown.drawn_s,
                    "concealed": shown.record.concealed,
                    "decode_s": shown.record.decode_s,
                    "bytes": shown.record.wire_bytes,
                }
                for shown in journal.frames.all()
            ],
            "arrivals": [
                {
                    "play": arrival.play,
                    "birth": arrival.birth,
                    "keyframe_frame": arrival.frame,
                    "first_layer": arrival.first_layer,
                    "layers": arrival.layers,
                    "bytes": arrival.wire_bytes,
                    "came_s": arrival.came_s,
                }
                for arrival in journal.arrivals.all()
            ],
            "rates": [
                {
                    "time_s": rates.time_s,
                    "goodput_bps": rates.goodput_bps,
                    "link_bps": rates.link_bps,
                }
                for rates in journal.rates(self.link, self.link_began_s)
            ],
            "dropped": {
                "frames": journal.frames.dropped,
                "arrivals": journal.arrivals.dropped,
            },
        }


def write_report(path: Path, summary: PlaySummary) -> None:
    """Writes the summary and what was noted as JSON; the file is whole or absent."""
    text = json.dumps(summary.to_json(), indent=1) + "\n"
    write_atomic(path, text.encode())
