"""Lines into a descriptor: in batches, by a thread, so that a slow sink holds nobody up.

Rule: the buffer is bounded. What does not fit is dropped and counted, and a line says so when the
sink takes lines again.
"""

from __future__ import annotations

import atexit
import os
import select
import stat
import threading
from collections.abc import Callable
from typing import Self

FLUSH_S = 0.2
"""Seconds that a line waits for others at most, unless the sink is slow."""

FLUSH_BYTES = 64 * 1024
"""Bytes that do not wait for more."""

MAX_BYTES = 1024 * 1024
"""Bytes that wait at most; further lines are dropped."""

CLOSE_S = 1.0
"""Seconds that the last lines get."""


class LogWriter:
    """Writes lines to `descriptor`, which stays its owner's.

    Before `start`, as in a process that is going to fork, every line is written at once. `with`
    starts it, and writes out what waits at the end.
    """

    def __init__(
        self,
        descriptor: int,
        dropped_line: Callable[[int], bytes] = lambda _: b"",
        max_bytes: int = MAX_BYTES,
    ) -> None:
        """dropped_line: the line that tells how many were dropped since the last such line."""
        self._descriptor = descriptor
        # Several workers may share a pipe: it keeps together only what is not longer than this.
        is_pipe = stat.S_ISFIFO(os.fstat(descriptor).st_mode)
        self._piece_bytes = select.PIPE_BUF if is_pipe else max_bytes
        self._dropped_line = dropped_line
        self._max_bytes = max_bytes
        self._lock = threading.Lock()
        self._lines: list[bytes] = []
        self._num_bytes = 0
        self._some = threading.Event()
        self._now = threading.Event()
        self._closing = False
        self._thread: threading.Thread | None = None
        self.num_dropped = 0
        """Lines that were dropped since the beginning."""
        self._num_told = 0

    def start(self) -> None:
        """From now on lines are buffered; at the end of the process they are written out."""
        if self._thread is None:
            self._closing = False
            self._thread = threading.Thread(target=self._run, name="log", daemon=True)
            self._thread.start()
            atexit.register(self.close)

    def __enter__(self) -> Self:
        self.start()
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def write(self, line: bytes, urgent: bool = False) -> None:
        """Takes in one line. urgent: it does not wait for others."""
        if self._thread is None:
            self.num_dropped += self._put([line])
            return
        with self._lock:
            if self._num_bytes + len(line) > self._max_bytes:
                self.num_dropped += 1
                return
            first = not self._num_bytes
            self._lines.append(line)
            self._num_bytes += len(line)
            num_bytes = self._num_bytes
        if first:
            self._some.set()
        if urgent or num_bytes >= FLUSH_BYTES:
            self._now.set()

    def close(self, timeout_s: float = CLOSE_S) -> None:
        """Writes out what waits, if the sink takes it within `timeout_s`."""
        thread = self._thread
        if thread is None:
            return
        self._closing = True
        self._now.set()
        self._some.set()
        thread.join(timeout_s)
        if not thread.is_alive():
            self._thread = None
        atexit.unregister(self.close)

    def _run(self) -> None:
        while not self._closing:
            self._some.wait()
            self._now.wait(FLUSH_S)
            self._flush()
        self._flush()

    def _flush(self) -> None:
        with self._lock:
            # What comes from here on sets them again.
            self._some.clear()
            self._now.clear()
            lines, self._lines = self._lines, []
        lost = self._put(lines)
        untold = self.num_dropped - self._num_told
        if untold and not self._put([self._dropped_line(untold)]):
            self._num_told += untold
        with self._lock:
            # Until now the lines that were being written counted: they took memory.
            self.num_dropped += lost
            self._num_bytes = sum(map(len, self._lines))
            if self._lines:
                self._some.set()
                if self._num_bytes >= FLUSH_BYTES or self._closing:
                    self._now.set()

    def _put(self, lines: list[bytes]) -> int:
        """Writes whole lines together, as many at a time as keep together. Gives how many were
        lost."""
        lost, begin, size = 0, 0, 0
        for n, line in enumerate(lines):
            if size and size + len(line) > self._piece_bytes:
                lost += self._put_piece(lines[begin:n])
                begin, size = n, 0
            size += len(line)
        return lost + self._put_piece(lines[begin:])

    def _put_piece(self, lines: list[bytes]) -> int:
        data = memoryview(b"".join(lines))
        while data:
            try:
                data = data[os.write(self._descriptor, data) :]
            except BlockingIOError:  # somebody else made it so
                poll = select.poll()
                poll.register(self._descriptor, select.POLLOUT)
                poll.poll(1000)
            except OSError:
                # A full disk, a reader that has gone: there is nobody to tell.
                return len(lines)
        return 0
