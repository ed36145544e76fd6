"""Whether pictures between two frames are drawn."""

from __future__ import annotations

from dataclasses import dataclass

FASTER = 1.05
"""Pictures are drawn between frames where there are so many times as many of them: a screen of
59.94 Hz is not faster than a stream of 60 frames a second."""


@dataclass(slots=True)
class Smoothing:
    """A switch, and the rate of what shows the pictures."""

    on: bool = False
    """May be changed at any time, by any thread."""
    pictures_hz: float = 60.0
    """Pictures a second that a screen shows, or a film has."""

    def shows_between(self, frames_hz: float) -> bool:
        """Whether pictures show motion between frames that come `frames_hz` a second."""
        return self.on and self.pictures_hz > FASTER * frames_hz
