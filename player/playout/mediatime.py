"""The time that a window plays by: that of the sound device, if there is one.

Rule: pure, but for `time_s`, which asks the world's clock. A device takes its samples in blocks, at
moments that scatter, by a crystal of its own. Their count says how fast its time passes; this
follows it slowly, so that pictures are as even as without sound.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable

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
