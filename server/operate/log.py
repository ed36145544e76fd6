"""The server's log: the logging module's queue, whose lines are JSON, or key=value for people.

Rule: a line is printable ASCII, its keys are ours, its values may come from strangers. Nobody waits
for a slow reader or a full disk: the queue is bounded, and what does not fit or cannot be written
is counted; a line says how many once writing works again.
"""

from __future__ import annotations

import json
import logging
import math
import os
import queue
import re
import select
import threading
import time
import traceback
from collections.abc import Mapping
from datetime import UTC, datetime
from enum import StrEnum
from logging.handlers import QueueHandler, QueueListener
from typing import Final, Self

from codec.errors import SwingsError

Value = str | int | float | bool | None
"""A field of an event; None leaves it out."""

STDERR: Final = 2
"""The descriptor of standard error."""

MAX_LINES: Final = 4096
"""Lines queued at most."""

MAX_CHARS: Final = 512
MAX_TRACEBACK_CHARS: Final = 3000
"""Characters kept of a text."""

LEVELS: Final = logging.getLevelNamesMapping()

CLOSE_S = 1.0
"""Maximum seconds to write what is queued at the end."""

_BARE = re.compile(r"[!#-<>-\[\]-~]+")
"""Text that needs no quotes: printable, without a space, a quote, = or a backslash."""


class LogStyle(StrEnum):
    """How lines look."""

    JSON = "json"
    """One JSON object a line."""
    PLAIN = "plain"
    """Time, level and event, then key=value."""


class LogRequests(StrEnum):
    """Requests that get a line."""

    PLAYS = "plays"
    """Plays and downloads, and what was answered with an error."""
    ALL = "all"


class LineFormatter(logging.Formatter):
    """Writes lines of one style."""

    def __init__(self, style: LogStyle) -> None:
        super().__init__()
        self._is_json = style is LogStyle.JSON

    def format(self, record: logging.LogRecord) -> str:
        """The line without its newline."""
        at = datetime.fromtimestamp(record.created, UTC).isoformat(timespec="milliseconds")
        event: str = getattr(record, "event", "record")
        told: Mapping[str, Value] | None = getattr(record, "fields", None)
        if told is None:
            told = _fields_of(record)
        fields = {key: _shown(key, value) for key, value in told.items() if value is not None}
        head = (f"{at.removesuffix('+00:00')}Z", record.levelname.lower(), event)
        if self._is_json:
            named = dict(zip(("time", "level", "event"), head, strict=True))
            return json.dumps({**named, **fields}, separators=(",", ":"))
        return " ".join((*head, *(f"{key}={_plain(value)}" for key, value in fields.items())))


class EventLog(QueueHandler):
    """One line for each event or record, on `descriptor`, which stays its owner's.

    `with` starts the thread that writes, and at the end writes what is queued.
    """

    def __init__(self, descriptor: int, style: LogStyle, max_lines: int = MAX_LINES) -> None:
        self._lines: queue.Queue[logging.LogRecord] = queue.Queue(max_lines)
        super().__init__(self._lines)
        self.setLevel(logging.INFO)
        self.setFormatter(LineFormatter(style))
        self._num_refused = 0
        self._num_reported = 0
        self._writer = _Writer(descriptor)
        self._listener = _Listener(self._lines, self._writer)
        self._listens = False

    @property
    def num_dropped(self) -> int:
        """Lines that were dropped since the beginning."""
        return self._num_refused + self._writer.num_unwritten

    def event(self, event: str, level: str = "info", /, **fields: Value) -> None:
        """Logs one event. event, keys: our own words; values may come from strangers."""
        told = {"event": event, "fields": fields, "levelname": level.upper()}
        self.handle(logging.makeLogRecord({**told, "levelno": LEVELS[level.upper()]}))

    def prepare(self, record: logging.LogRecord) -> logging.LogRecord:
        """The record as its line, written by the caller: what it names may change."""
        return logging.makeLogRecord({"msg": self.format(record)})

    def enqueue(self, record: logging.LogRecord) -> None:
        dropped = self.num_dropped
        try:
            if dropped > self._num_reported:
                lines = {"event": "log_dropped", "fields": {"lines": dropped - self._num_reported}}
                told = logging.makeLogRecord({**lines, "levelname": "WARNING"})
                self._lines.put_nowait(self.prepare(told))
                self._num_reported = dropped
            self._lines.put_nowait(record)
        except queue.Full:
            self._num_refused += 1

    def handleError(self, record: logging.LogRecord) -> None:
        """What has no line is counted; printing it, as the logging module does, could block."""
        self._num_refused += 1

    def __enter__(self) -> Self:
        self._listener.start()
        self._listens = True
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Writes what is queued, if the sink accepts it in time. The logging module calls it at the
        end of the process, too."""
        if self._listens:
            self._listens = False
            closing = threading.Thread(target=self._listener.stop, daemon=True)
            closing.start()
            closing.join(CLOSE_S)
        super().close()


class _Listener(QueueListener):
    def enqueue_sentinel(self) -> None:
        while True:
            try:
                return super().enqueue_sentinel()
            except queue.Full:
                time.sleep(0.01)


class _Writer(logging.Handler):
    """Writes lines whole; without the lock of a handler, which a stuck sink would keep."""

    def __init__(self, descriptor: int) -> None:
        super().__init__()
        self._descriptor = descriptor
        self.num_unwritten = 0

    def handle(self, record: logging.LogRecord) -> bool:
        data = memoryview(f"{record.msg}\n".encode("ascii"))
        while data:
            try:
                data = data[os.write(self._descriptor, data) :]
            except BlockingIOError:  # another process set O_NONBLOCK on the shared description
                poll = select.poll()
                poll.register(self._descriptor, select.POLLOUT)
                poll.poll(1000)
            except OSError:  # a full disk, or a reader that is gone
                self.num_unwritten += 1
                return False
        return True


def take_over_logging(log: EventLog) -> None:
    """From now on all records go to `log`, once each, and nowhere else."""
    root = logging.getLogger()
    for other in root.handlers[:]:
        root.removeHandler(other)
    root.addHandler(log)
    root.setLevel(min(root.level, logging.INFO))


def _fields_of(record: logging.LogRecord) -> dict[str, Value]:
    """The fields of a record of the logging module. An exception that names its cause needs no
    traceback; others are bugs."""
    try:
        message = record.getMessage()
    except Exception:
        message = f"{record.msg} (with the wrong arguments)"
    fields: dict[str, Value] = {"logger": record.name, "message": message}
    error = record.exc_info[1] if record.exc_info else None
    if isinstance(error, SwingsError | OSError):
        fields["error"] = f"{type(error).__name__}: {error}"
    elif error is not None:
        fields["traceback"] = "".join(traceback.format_exception(error)).rstrip()
    return fields


def _shown(key: str, value: Value) -> Value:
    """A value as JSON has it; a long text without its end, a traceback without its beginning, as it
    ends with the error."""
    if isinstance(value, float):
        return round(value, 6) if math.isfinite(value) else str(value)
    if not isinstance(value, str):
        return value
    if key == "traceback":
        most = MAX_TRACEBACK_CHARS
        return value if len(value) <= most else f"...{value[3 - most :]}"
    return value if len(value) <= MAX_CHARS else f"{value[: MAX_CHARS - 3]}..."


def _plain(value: Value) -> str:
    if isinstance(value, str) and _BARE.fullmatch(value):
        return value
    return json.dumps(value)
