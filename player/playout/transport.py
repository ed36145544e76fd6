"""Where a playback goes on: what seeking, stepping, looping and the end of the stream lead to.

Rule: pure. It knows frames, not times: pause and rate belong to the clock.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from codec.errors import InvalidError

RATES = (0.1, 0.25, 0.5, 1.0, 1.5, 2.0, 4.0)
"""Rates that the keys step through, seconds of media per second."""


LIVE_LEAD_S = 1.0
"""How far from the edge of a live stream one begins, at most: nearer, the picture would stand still
until the next segment."""

LIVE_MARGIN_S = 0.1
"""What a segment that was just written may be late by, beyond its length."""


def live_lead_s(segment_s: float) -> float:
    """How far from the edge of a live stream with segments of `segment_s` one begins, seconds."""
    return min(LIVE_LEAD_S, segment_s + LIVE_MARGIN_S)


@dataclass(slots=True)
class Transport:
    """The frames that may be played, and which of them shows."""

    first_frame: int
    end_frame: int | None
    """The first frame that will not come; None while it is not known."""
    fps: float
    plays_left: float = 1
    """How often it is played yet, this time included; math.inf for without end."""
    shown: int | None = None
    """The last frame that showed; None before the first one."""
    lead_s: float = LIVE_LEAD_S
    """How far from the edge of a live stream `newest` is."""
    known_end: int = 0
    """Frames before this one are there, of a stream whose end is not known."""

    def __post_init__(self) -> None:
        if self.end_frame is not None and self.end_frame <= self.first_frame:
            raise InvalidError(f"there is no frame to play in {self.first_frame}:{self.end_frame}")

    @property
    def last_frame(self) -> int:
        """The last frame that one can go to."""
        end = self.known_end if self.end_frame is None else self.end_frame
        return max(self.first_frame, end - 1)

    @property
    def newest(self) -> int:
        """The frame to seek to for the newest pictures."""
        if self.end_frame is not None:
            return self.last_frame
        return self.seek(self.last_frame - round(self.lead_s * self.fps))

    @property
    def at_end(self) -> bool:
        """Whether the last frame shows."""
        return (
            self.shown is not None and self.end_frame is not None and self.shown >= self.last_frame
        )

    @property
    def loops(self) -> bool:
        """Whether it begins anew at the end."""
        return self.plays_left > 1

    def toggle_loop(self) -> bool:
        """Plays without end, or only to the end of this time; gives whether it is without end."""
        self.plays_left = 1 if self.loops else math.inf
        return self.loops

    def seek(self, frame: int) -> int:
        """The frame to play from where `frame` is wanted."""
        return min(max(frame, self.first_frame), self.last_frame)

    def skip(self, seconds: float, from_frame: int | None = None) -> int:
        """The frame to play from where `seconds` of media, of either sign, are to be skipped.
        from_frame: where a seek that has not come to its end leads; None for what shows."""
        at = self.shown if from_frame is None else from_frame
        at = self.first_frame if at is None else at
        return self.seek(at + round(seconds * self.fps))


def next_rate(rate: float, steps: int) -> float:
    """The rate `steps` places on in RATES, of either sign."""
    nearest = min(range(len(RATES)), key=lambda n: abs(RATES[n] - rate))
    return RATES[min(max(nearest + steps, 0), len(RATES) - 1)]
