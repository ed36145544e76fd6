"""Counters of the sound, for the report of a playback."""

from __future__ import annotations

from dataclasses import dataclass


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
