"""One thread that does small jobs ahead of time; a bounded number of them may wait."""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Callable
from typing import Generic, TypeVar

_Job = TypeVar("_Job")


class Prefetcher(Generic[_Job]):
    """Does jobs in the order in which they were asked for; refuses one when too many wait.

    Any thread may ask. The thread starts with the first job and ends with `close`.
    """

    def __init__(self, do: Callable[[_Job], None], max_waiting: int) -> None:
        """do: what to do with a job; must not raise."""
        self._do = do
        self._max_waiting = max_waiting
        self._changed = threading.Condition()  # guards all below
        self._waiting: deque[_Job] = deque()
        self._thread: threading.Thread | None = None

    def ask(self, job: _Job) -> bool:
        """Queues a job; False if too many wait."""
        with self._changed:
            if len(self._waiting) >= self._max_waiting:
                return False
            self._waiting.append(job)
            if self._thread is None:
                self._thread = threading.Thread(target=self._work, name="prefetch", daemon=True)
                self._thread.start()
            self._changed.notify()
            return True

    def close(self) -> None:
        """Forgets the jobs that wait and returns when the running one has ended. Idempotent; a
        later job starts a new thread."""
        with self._changed:
            self._waiting.clear()
            thread, self._thread = self._thread, None
            self._changed.notify_all()
        if thread is not None:
            thread.join()

    def _work(self) -> None:
        while True:
            with self._changed:
                while not self._waiting and self._thread is threading.current_thread():
                    self._changed.wait()
                if self._thread is not threading.current_thread():
                    return
                job = self._waiting.popleft()
            self._do(job)
