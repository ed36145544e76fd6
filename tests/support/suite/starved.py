"""Checks whether a test gets enough CPU time for its time measurements to be meaningful."""

from __future__ import annotations

import os
import threading
import time
from types import TracebackType

LATE_S = 0.01
"""Delay of a sleep, in seconds, from which on it counts as a wait for a processor."""

BUSY_SHARE = 0.85
"""Share of the processors' time used by all processes from which on a machine is busy."""

STARVED_SHARE = 0.02
"""Share of the time lost in such waits from which on measured times are meaningless."""


class Watch:
    """Sleeps repeatedly during a measurement, and sums up how late it wakes.

    `starved`: this process did not get its CPU time. `busy`: the machine had none to spare, so that
    other processes may not have got theirs.
    """

    def __init__(self) -> None:
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run)
        self._began_s = time.monotonic()
        self._lost_s = 0.0
        self._idle_s = _idle_s()
        self.starved = False
        self.busy = False

    def _run(self) -> None:
        while not self._stop.is_set():
            began_s = time.monotonic()
            time.sleep(0.002)
            late_s = time.monotonic() - began_s - 0.002
            self._lost_s += late_s if late_s > LATE_S else 0.0

    def __enter__(self) -> Watch:
        self._thread.start()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._stop.set()
        self._thread.join()
        took_s = time.monotonic() - self._began_s
        self.starved = self._lost_s > STARVED_SHARE * took_s
        most_s = took_s * (os.cpu_count() or 1)
        self.busy = self._idle_s >= 0 and _idle_s() - self._idle_s < (1 - BUSY_SHARE) * most_s


def _idle_s() -> float:
    """Idle time of all processors together, in seconds; -1 if it is not known."""
    try:
        with open("/proc/stat") as file:
            fields = file.readline().split()
    except OSError:
        return -1
    return (int(fields[4]) + int(fields[5])) / os.sysconf("SC_CLK_TCK")
