"""The server's log: lines of JSON, or key=value for people.

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
import traceback
from contextlib import suppress
from datetime import UTC, datetime
from enum import StrEnum
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

CLOSE_S = 1.0
"""Maximum seconds to queue the end of the log, and to write what is queued."""

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
        head = {
            "time": at.removesuffix("+00:00") + "Z",
            "level": record.levelname.lower(),
            "event": getattr(record, "event", "record"),
        }
        told: dict[str, Value] | None = getattr(record, "fields", None)
        told = _fields_of(record) if told is None else told
        fields = {key: _shown(key, value) for key, value in told.items() if value is not None}
        if self._is_json:
            return json.dumps({**head, **fields}, separators=(",", ":"))
        return " ".join((*head.values(), *(f"{k}={_plain(value)}" for k, value in fields.items())))


def _fields_of(record: logging.LogRecord) -> dict[str, Value]:
    """The fields of a record of the logging module. An exception that names its cause needs no
    traceback; others are bugs."""
    fields: dict[str, Value] = {"logger": record.name, "message": record.getMessage()}
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
    return value if isinstance(value, str) and _BARE.fullmatch(value) else json.dumps(value)


class EventLog(logging.Handler):
    """One line for each event or record, on `descriptor`, which stays its owner's.

    `with` starts the thread that writes, and at the end writes what is queued.
    """

    def __init__(self, descriptor: int, style: LogStyle, max_lines: int = MAX_LINES) -> None:
        super().__init__(logging.INFO)
        self.setFormatter(LineFormatter(style))
        self._descriptor = descriptor
        self._lines: queue.Queue[str | None] = queue.Queue(max_lines)
        self._writer = threading.Thread(target=self._write_lines, daemon=True)
        self._num_refused = 0
        self._num_unwritten = 0
        self._num_reported = 0

    @property
    def num_dropped(self) -> int:
        """Lines that were dropped since the beginning."""
        return self._num_refused + self._num_unwritten

    def event(self, event: str, level: str = "info", /, **fields: Value) -> None:
        """Logs one event. event, keys: our own words; values may come from strangers."""
        told = {"event": event, "fields": fields, "levelname": level.upper()}
        self.handle(logging.makeLogRecord(told))

    def emit(self, record: logging.LogRecord) -> None:
        """Queues the line, written here: what the record names may change."""
        dropped = self.num_dropped
        try:
            line = self.format(record)
            if dropped > self._num_reported:
                fields = {"lines": dropped - self._num_reported}
                told = {"event": "log_dropped", "fields": fields, "levelname": "WARNING"}
                self._lines.put_nowait(self.format(logging.makeLogRecord(told)))
                self._num_reported = dropped
            self._lines.put_nowait(line)
        except Exception:  # the queue is full, or no line can be made of the record
            self._num_refused += 1

    def _write_lines(self) -> None:
        while (line := self._lines.get()) is not None:
            data = memoryview(f"{line}\n".encode("ascii"))
            while data:
                try:
                    data = data[os.write(self._descriptor, data) :]
                except BlockingIOError:  # another process set O_NONBLOCK on the shared description
                    select.select((), (self._descriptor,), (), 1.0)
                except OSError:  # a full disk, or a reader that is gone
                    self._num_unwritten += 1
                    break

    def __enter__(self) -> Self:
        self._writer.start()
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Writes what is queued, if the sink accepts it in time. The logging module calls it at the
        end of the process, too."""
        if self._writer.is_alive():
            with suppress(queue.Full):
                self._lines.put(None, timeout=CLOSE_S)
                self._writer.join(CLOSE_S)
        super().close()


def take_over_logging(log: EventLog) -> None:
    """From now on all records go to `log`, once each, and nowhere else."""
    root = logging.getLogger()
    for other in root.handlers[:]:
        root.removeHandler(other)
    root.addHandler(log)
    root.setLevel(min(root.level, logging.INFO))
