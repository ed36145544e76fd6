"""Work on a thread, polled by the caller."""

from __future__ import annotations

import threading
from collections.abc import Callable


class BackgroundTask:
    """Runs `work` on a thread of its own, which does not keep the program from ending."""

    def __init__(self, work: Callable[[], object]) -> None:
        self._work = work
        self._error: BaseException | None = None
        self._thread = threading.Thread(target=self._run, name="background-task", daemon=True)
        self._thread.start()

    def _run(self) -> None:
        try:
            self._work()
        except BaseException as error:
            self._error = error

    def is_done(self) -> bool:
        """Whether it has ended. Raises what the work raised."""
        if self._thread.is_alive():
            return False
        self._thread.join()
        if self._error is not None:
            raise self._error
        return True
