"""Counters of the sound, for the report of a playback."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(slots=True)
class SoundCounts:
    """What the sound of a playback came to."""

    received_bytes: int = 0
    """Bytes of its objects."""
    segments: int = 0
    """Segments that were decoded."""
    failed_segments: int = 0
    """Segments that could not be had, and were silent."""
    missing_s: float = 0.0
    """Time for which it was silent because a segment was not there yet."""
