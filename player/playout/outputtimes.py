"""The pictures of a film whose rate differs from the stream's, and the moment that each shows.

Rule: pure, and exact: picture n shows the stream n / rate seconds after its first frame, by
fractions, however long the film.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from fractions import Fraction

from codec.errors import InvalidError

MAX_FPS = 1000.0
"""Highest rate of a film, pictures per second."""

LARGEST_PART = 1001
"""Largest denominator of a rate, as in 30000/1001."""


def exact_rate(fps: float) -> Fraction:
    """`fps` as an exact fraction: 30000/1001 for 29.97002997, but 2997/100 for 29.97."""
    return Fraction(fps).limit_denominator(LARGEST_PART)


def check_fps(fps: float) -> None:
    """Raises InvalidError unless `fps` is a possible rate of a film."""
    if not 1 / LARGEST_PART <= fps <= MAX_FPS:
        raise InvalidError(f"fps {fps:g} is not within 0.001..{MAX_FPS:g}")


@dataclass(frozen=True, slots=True)
class Picture:
    """A picture of the film."""

    number: int
    """Number of the picture in the film, from 0."""
    position: Fraction
    """Its time in frames of the stream, from the first one; a fraction between two frames."""
    share: float
    """Share of the way from the previous frame to the uploaded one; 1 is the uploaded frame."""


class OutputTimes:
    """The pictures of a film of `fps` from frames that come at `stream_fps`, one after another.

    The film lasts as long as its frames do: each frame a frame time, the last one too.
    """

    def __init__(self, stream_fps: float, fps: float, interpolates: bool) -> None:
        """interpolates: whether pictures between two frames show motion; else the frame before
        them stands."""
        check_fps(fps)
        self._step = exact_rate(stream_fps) / exact_rate(fps)  # frames from picture to picture
        self._interpolates = interpolates
        self._next = 0

    def count(self, num_frames: int) -> int:
        """Pictures of a film of so many frames."""
        return math.ceil(num_frames / self._step)

    def with_frame(self, frame: int) -> list[Picture]:
        """The pictures to draw once `frame`, from 0 on, is uploaded: those from the frame before to
        its own time, or, where nothing is interpolated, those before the next frame. Call it for
        every frame, in order."""
        if not self._interpolates:
            return self.behind(frame)
        return list(self._until(frame, inclusive=True))

    def behind(self, frame: int) -> list[Picture]:
        """The pictures to draw with `frame` uploaded, in the time before the next one, if nothing
        shows the way there: at the end, and before a loop begins anew."""
        return list(self._until(frame + 1, inclusive=False))

    def _until(self, end: int, inclusive: bool) -> Iterator[Picture]:
        while True:
            position = self._next * self._step
            if position > end or (position == end and not inclusive):
                return
            yield Picture(self._next, position, float(position - (end - 1)) if inclusive else 1.0)
            self._next += 1
