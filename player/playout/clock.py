"""The clock that stamps arrivals and frames: seconds of media since the player started.

Rule: nothing else in the playout reads the time; all decisions get `now_s` as an argument.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable

from codec.errors import InvalidError

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
