"""Whether a machine leaves a test enough of its time for it to measure any."""

from __future__ import annotations

import threading
import time
from types import TracebackType

LATE_S = 0.01
"""A sleep that ends so much too late, in seconds, waited for a processor."""

STARVED_SHARE = 0.02
"""Share of the time lost in such waits from which on times say nothing."""


class Watch:
    """Sleeps again and again beside what is measured, and sees how late it wakes."""

    def __init__(self) -> None:
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run)
        self._began_s = time.monotonic()
        self._lost_s = 0.0
        self.starved = False

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
        self.starved = self._lost_s > STARVED_SHARE * (time.monotonic() - self._began_s)
