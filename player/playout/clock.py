"""The clock that stamps arrivals and frames: seconds since the player started.

Rule: nothing else in the playout reads the time; whoever decides something gets `now_s` as an
argument.
"""

from __future__ import annotations

import threading
import time


class Clock:
    """A clock that can be stopped: seconds since it was made, without the time it was stopped.

    `real` says what a due time means. With True a frame waits until it is due: in a window, and
    wherever what comes depends on how fast it comes. With False it never waits (a capture of what
    comes in any case): every frame comes as soon as it can be drawn, and the clock only stamps
    arrivals.
    """

    def __init__(self, real: bool) -> None:
        self.real = real
        self._lock = threading.Lock()
        self._origin_s = time.monotonic()
        self._stopped_at_s: float | None = None

    def now_s(self) -> float:
        with self._lock:
            at_s = time.monotonic() if self._stopped_at_s is None else self._stopped_at_s
            return at_s - self._origin_s

    @property
    def running(self) -> bool:
        return self._stopped_at_s is None

    def stop(self) -> None:
        """Holds the time where it is; does nothing when it is stopped already."""
        with self._lock:
            if self._stopped_at_s is None:
                self._stopped_at_s = time.monotonic()

    def start(self) -> None:
        """Lets the time go on from where it was held."""
        with self._lock:
            if self._stopped_at_s is not None:
                self._origin_s += time.monotonic() - self._stopped_at_s
                self._stopped_at_s = None

    def until_s(self, due_s: float) -> float:
        """How long to wait for `due_s`, seconds; 0 when it is past or nothing ever waits."""
        return max(0.0, due_s - self.now_s()) if self.real else 0.0
