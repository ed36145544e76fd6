"""How a playback went: a summary for people, and a JSON file for tools."""

from __future__ import annotations

import json
from collections import deque
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

from codec.files import write_atomic
from player.playout.timeline import PlayoutTotals
from server.abr.link import Link

from .journal import Journal
from .soundcounts import SoundCounts

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
                    "snapshot_frame": arrival.frame,
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
