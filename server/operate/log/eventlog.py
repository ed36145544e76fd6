"""The server's log: a handler of the logging module whose lines are written by a thread.

Rule: the queue is bounded, so that a slow reader or a full disk never stalls the event loop. Lines
that do not fit are dropped and counted, and a line reports the count once writing works again.
"""

from __future__ import annotations

import logging
import os
import select
import stat
import threading
import time
from collections import OrderedDict, deque
from typing import Self

from .logline import LineFormatter, LogStyle, Value, message_of

STDERR = 2
"""The descriptor of standard error."""

MAX_LINES = 4096
"""Lines queued at most."""

PIECE_BYTES = 64 * 1024
"""Maximum bytes of one write; for a pipe PIPE_BUF, so that workers do not tear lines."""

BATCH_S = 0.05
"""Seconds that the thread waits for further lines before it writes the first."""

CLOSE_S = 1.0
"""Maximum seconds to queue the end, and to write what is queued before it."""

REPEAT_S = 60.0
"""Seconds in which the same warning is logged once."""

MAX_REPEATS = 256
"""Warnings remembered for that; beyond it, the one logged longest ago is forgotten."""


class RepeatFilter(logging.Filter):
    """Passes the same warning once in REPEAT_S, with the count held back since."""

    def __init__(self) -> None:
        super().__init__()
        self._logged: OrderedDict[str, tuple[float, int]] = OrderedDict()  # when; held back since

    def filter(self, record: logging.LogRecord) -> bool:
        if record.levelno < logging.WARNING:
            return True
        key = f"{record.name} {message_of(record)}"
        logged_s, held_back = self._logged.get(key, (-REPEAT_S, 0))
        if record.created - logged_s < REPEAT_S:
            self._logged[key] = logged_s, held_back + 1
            return False
        self._logged[key] = record.created, 0
        self._logged.move_to_end(key)
        if len(self._logged) > MAX_REPEATS:
            self._logged.popitem(last=False)
        record.held_back = held_back or None
        return True


class EventLog(logging.Handler):
    """Writes one line an event or record to `descriptor`, which stays its owner's.

    `with` starts the thread, and at the end writes what is queued. Without it, as in a process that
    forks, the caller writes each line itself.
    """

    def __init__(self, descriptor: int, style: LogStyle, max_lines: int = MAX_LINES) -> None:
        super().__init__(logging.INFO)
        self._formatter = LineFormatter(style)
        self.setFormatter(self._formatter)
        self.addFilter(RepeatFilter())
        # Not queue.Queue: at thousands of lines a second its locks cost more than all the rest.
        self._lines = deque[bytes]()
        self._max_lines = max_lines
        self._waiting = threading.Event()  # lines to be written, or the end
        self._closing = threading.Event()
        self._descriptor = descriptor
        is_pipe = stat.S_ISFIFO(os.fstat(descriptor).st_mode)
        self._piece_bytes = select.PIPE_BUF if is_pipe else PIECE_BYTES
        self._thread: threading.Thread | None = None
        # Two counters, because the callers and the thread must not change the same one.
        self._num_refused = 0
        self._num_unwritten = 0
        self._num_reported = 0

    @property
    def num_dropped(self) -> int:
        """Lines that were dropped since the beginning."""
        return self._num_refused + self._num_unwritten

    def event(self, event: str, level: str = "info", /, **fields: Value) -> None:
        """Logs one event, however often it comes. event, keys: our own words; values may come from
        strangers. Without a LogRecord, whose making costs more than the line."""
        try:
            line = self._formatter.line(time.time(), level, event, fields)
        except Exception:
            self._refuse()
        else:
            self._enqueue(line)

    def emit(self, record: logging.LogRecord) -> None:
        try:
            self._enqueue(self.format(record))
        except Exception:  # printing it, as the logging module does, could block
            self._refuse()

    def _enqueue(self, line: str) -> None:
        data = f"{line}\n".encode("ascii")
        if self._thread is None:
            self._write(data, 1)
        elif len(self._lines) >= self._max_lines:
            self._refuse()
        else:
            self._lines.append(data)
            if len(self._lines) == 1:
                self._waiting.set()

    def _refuse(self) -> None:
        assert self.lock is not None
        with self.lock:
            self._num_refused += 1

    def __enter__(self) -> Self:
        self._closing.clear()
        self._thread = threading.Thread(target=self._run, name="log", daemon=True)
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Writes what is queued, if the sink accepts it in time. The logging module calls it at the
        end of the process, too."""
        if self._thread is not None and not self._closing.is_set():
            self._closing.set()
            self._waiting.set()
            self._thread.join(CLOSE_S)
            if not self._thread.is_alive():
                self._thread = None
        super().close()

    def _run(self) -> None:
        while True:
            self._waiting.wait()
            closing = self._closing.wait(BATCH_S)
            self._waiting.clear()
            while self._lines:
                piece, num_lines = bytearray(self._lines.popleft()), 1
                while self._lines and len(piece) + len(self._lines[0]) <= self._piece_bytes:
                    piece += self._lines.popleft()
                    num_lines += 1
                self._write(piece, num_lines)
            if closing:
                return

    def _write(self, piece: bytes | bytearray, num_lines: int) -> None:
        """Writes whole lines, and then how many were dropped since the last such report."""
        if not self._put(piece):
            self._num_unwritten += num_lines
            return
        dropped = self.num_dropped
        if dropped > self._num_reported:
            fields = {"lines": dropped - self._num_reported}
            line = self._formatter.line(time.time(), "warning", "log_dropped", fields)
            if self._put(f"{line}\n".encode("ascii")):
                self._num_reported = dropped

    def _put(self, piece: bytes | bytearray) -> bool:
        data = memoryview(piece)
        while data:
            try:
                data = data[os.write(self._descriptor, data) :]
            except BlockingIOError:  # another process set O_NONBLOCK on the shared description
                poll = select.poll()
                poll.register(self._descriptor, select.POLLOUT)
                poll.poll(1000)
            except OSError:  # a full disk, or a reader that is gone
                return False
        return True


def take_over_logging(log: EventLog) -> None:
    """From now on all records go to `log`, once each, and nowhere else."""
    root = logging.getLogger()
    for other in root.handlers[:]:
        root.removeHandler(other)
    root.addHandler(log)
    root.setLevel(min(root.level, logging.INFO))
