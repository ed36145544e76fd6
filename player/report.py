"""How a playback went: a summary for people, and a JSON file for tools."""

from __future__ import annotations

import json
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from codec.files import write_atomic
from player.playout.timeline import FrameRecord, PlayoutTotals


@dataclass(slots=True)
class PlaySummary:
    """How a playback went."""

    source: str
    renderer: str
    totals: PlayoutTotals
    received_bytes: int
    uploaded_bytes: int
    link_bytes: int | None
    """Bytes that came over `--link`; None without it."""
    records: list[FrameRecord] = field(default_factory=list)
    """One for each frame, kept for `--report` only: it grows with the stream."""

    def lines(self) -> list[str]:
        """The summary for people."""
        totals = self.totals
        return [
            f"{totals.frames} frames of {self.source}, drawn by {self.renderer}",
            f"startup {totals.startup_s:.3f} s, {totals.stalls} stalls, "
            f"{totals.stalled_s:.3f} s stalled",
            f"{totals.mean_layers:.2f} layers on average, {totals.wire_bytes} bytes in packets; "
            f"{totals.late_packets} packets came late",
        ]

    def to_json(self) -> dict[str, Any]:
        totals = self.totals
        return {
            "source": self.source,
            "renderer": self.renderer,
            "totals": {
                "frames": totals.frames,
                "startup_s": totals.startup_s,
                "stalls": totals.stalls,
                "stalled_s": totals.stalled_s,
                "mean_layers": totals.mean_layers,
                "bytes": totals.wire_bytes,
                "received_bytes": self.received_bytes,
                "uploaded_bytes": self.uploaded_bytes,
                "link_bytes": self.link_bytes,
                "late_packets": totals.late_packets,
                "most_frames_waiting": totals.most_frames_waiting,
                "most_bytes_waiting": totals.most_bytes_waiting,
            },
            "frames": [
                {
                    "frame": record.frame,
                    "layers": record.layers,
                    "due_s": record.due_s,
                    "shown_s": record.shown_s,
                    "bytes": record.wire_bytes,
                }
                for record in self.records
            ],
        }


def write_report(path: Path, summary: PlaySummary) -> None:
    """Writes the summary and its records as JSON; the file is whole or absent."""
    text = json.dumps(summary.to_json(), indent=1) + "\n"
    write_atomic(path, text.encode())
