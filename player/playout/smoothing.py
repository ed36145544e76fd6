"""The switch and the rates that decide whether pictures between two frames are drawn."""

from __future__ import annotations

from dataclasses import dataclass

FASTER = 1.05
"""Least ratio of pictures to frames a second at which pictures between frames are drawn: a screen
of 60 Hz is not faster than a stream of 59.94 frames a second."""


@dataclass(slots=True)
class Smoothing:
    """A switch, and the rate of the screen or film that shows the pictures."""

    on: bool = False
    """May be changed at any time, by any thread."""
    pictures_hz: float = 60.0
    """Pictures a second that a screen shows, or a film has."""

    def shows_between(self, frames_hz: float) -> bool:
        """Whether pictures between frames are drawn for a stream at `frames_hz`."""
        return self.on and self.pictures_hz > FASTER * frames_hz
