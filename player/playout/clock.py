"""The clocks of a playback: seconds of media since the player started, the sound device's time, and
the moments of a film of another rate.

Rule: nothing else in the playout reads the time; all decisions get `now_s` as an argument. A device
takes its samples in blocks, at moments that scatter, by a crystal of its own. Their count says how
fast its time passes; `DeviceTime` follows it slowly, so that pictures are as even as without sound.
Picture n of a film shows the stream n / rate seconds after its first frame, by fractions, however
long the film.
"""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from fractions import Fraction

from codec.errors import InvalidError

FOLLOWED = 0.02
"""Part of the difference to the device by which each block moves this time."""

JUMP_S = 0.1
"""A difference that is larger is no scatter: the device had stopped, or lost samples."""


class DeviceTime:
    """Seconds of the world, as the sound device counts them; before any block, and after the last,
    as `world_s` does."""

    def __init__(self, world_s: Callable[[], float] = time.monotonic) -> None:
        self._world_s = world_s
        self._lock = threading.Lock()
        self._offset_s = 0.0  # this time less the world's
        self._next_s: float | None = None  # when the next sample is heard
        self._latest_s = 0.0

    def time_s(self) -> float:
        """The present time; never earlier than the last answer."""
        with self._lock:
            return self._time_s()

    def _time_s(self) -> float:
        self._latest_s = max(self._latest_s, self._world_s() + self._offset_s)
        return self._latest_s

    def pulled(self, duration_s: float, latency_s: float) -> float:
        """The device asks now for samples of `duration_s`, whose first is heard `latency_s` from
        now; gives the time at which that is."""
        with self._lock:
            expected_s = self._time_s() + latency_s
            begin_s = self._next_s
            if begin_s is None or abs(begin_s - expected_s) > JUMP_S:
                begin_s = expected_s
            self._offset_s += FOLLOWED * (begin_s - expected_s)
            self._next_s = begin_s + duration_s
            return begin_s


MIN_RATE, MAX_RATE = 0.1, 4.0
"""Slowest and fastest, seconds of media in a second."""


class Clock:
    """A clock that can be stopped, slowed down and sped up: seconds since it was made, without the
    time it was stopped, `rate` of them in a second.

    `real` says what a due time means. With True a frame waits until it is due: in a window, and
    wherever what comes depends on how fast it comes. With False it never waits (a capture of what
    comes in any case): every frame comes as soon as it can be drawn, and the clock only stamps
    arrivals.
    """

    def __init__(self, real: bool, time_s: Callable[[], float] = time.monotonic) -> None:
        """time_s: gives the time of the world, in seconds from anywhere."""
        self.real = real
        self._time_s = time_s
        self._lock = threading.Lock()
        # At `_base_s` of the world this clock showed `_shown_s`.
        self._base_s, self._shown_s = time_s(), 0.0
        self._rate = 1.0
        self._running = True

    def now_s(self) -> float:
        with self._lock:
            return self._now_s()

    def at(self, world_s: float) -> tuple[float, float] | None:
        """The time on this clock at `world_s`, a moment of `time_s` shortly after now, and the rate
        of this clock; None while it is stopped."""
        with self._lock:
            if not self._running:
                return None
            return self._shown_s + self._rate * (world_s - self._base_s), self._rate

    def _now_s(self) -> float:
        passed_s = self._time_s() - self._base_s if self._running else 0.0
        return self._shown_s + self._rate * passed_s

    def _rebase(self) -> None:
        self._shown_s, self._base_s = self._now_s(), self._time_s()

    @property
    def running(self) -> bool:
        return self._running

    @property
    def rate(self) -> float:
        """Seconds of media in a second."""
        return self._rate

    def stop(self) -> None:
        """Holds the time where it is; does nothing when it is stopped already."""
        with self._lock:
            self._rebase()
            self._running = False

    def start(self) -> None:
        """Lets the time go on from where it was held."""
        with self._lock:
            self._rebase()
            self._running = True

    def set_rate(self, rate: float) -> None:
        """Lets the time go on `rate` times as fast as the world's. Raises InvalidError."""
        if not MIN_RATE <= rate <= MAX_RATE:
            raise InvalidError(f"a rate of {rate} is not within {MIN_RATE}..{MAX_RATE}")
        with self._lock:
            self._rebase()
            self._rate = rate

    def skip_to(self, at_s: float) -> None:
        """Moves the time on to `at_s`; what lies behind stays behind."""
        with self._lock:
            self._rebase()
            self._shown_s = max(self._shown_s, at_s)

    def until_s(self, due_s: float) -> float | None:
        """How long to wait for `due_s`, seconds of the world; 0 when it is past or nothing ever
        waits, None while the clock stands."""
        with self._lock:
            ahead_s = due_s - self._now_s()
            if not self.real or ahead_s <= 0:
                return 0.0
            return ahead_s / self._rate if self._running else None


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
