"""The log as the server's parts see it, and records of the logging module in the same lines."""

from __future__ import annotations

import logging
import time
import traceback
from collections import OrderedDict
from collections.abc import Callable, Mapping

from codec.errors import SwingsError

from .logline import LineFormat, LogStyle, Value
from .logwriter import LogWriter

REPEAT_S = 60.0
"""Seconds in which the same event is told once."""

MAX_EVENTS = 256
"""Events that are remembered for that; then the one that was not told for longest goes."""


class Repeats:
    """Tells the same event once in a while, with how often it came. No clock."""

    def __init__(self, every_s: float = REPEAT_S, max_events: int = MAX_EVENTS) -> None:
        self._every_s = every_s
        self._max_events = max_events
        self._told: OrderedDict[str, tuple[float, int]] = OrderedDict()  # when; held back since

    def tell(self, event: str, now_s: float) -> int | None:
        """How many of `event` were held back since it was told; None where it is held back now."""
        told_s, held = self._told.get(event, (None, 0))
        if told_s is not None and now_s - told_s < self._every_s:
            self._told[event] = told_s, held + 1
            return None
        self._told[event] = now_s, 0
        self._told.move_to_end(event)
        if len(self._told) > self._max_events:
            self._told.popitem(last=False)
        return held


class EventLog:
    """Writes one line an event."""

    def __init__(
        self, descriptor: int, style: LogStyle, clock: Callable[[], float] = time.time
    ) -> None:
        """descriptor: where lines go, such as 2. clock: gives Unix time."""
        self._format = LineFormat(style)
        self._clock = clock
        self._repeats = Repeats()
        self.writer = LogWriter(descriptor, self._dropped)

    def event(self, event: str, /, **fields: Value) -> None:
        """A line of level info. event, keys: our own words; values may be anybody's."""
        self.writer.write(self._format.line(self._clock(), "info", event, fields))

    def often(
        self, event: str, texts: tuple[tuple[str, str], ...], numbers: Mapping[str, int | float]
    ) -> None:
        """The same of an event that comes often, with texts that came before: at less cost.
        numbers: finite ones."""
        self.writer.write(self._format.often(self._clock(), event, texts, numbers))

    def trouble(self, event: str, /, level: str = "error", **fields: Value) -> None:
        """A line that does not wait for others."""
        self.writer.write(self._format.line(self._clock(), level, event, fields), urgent=True)

    def repeated(self, event: str, /, level: str = "warning", **fields: Value) -> None:
        """A line that comes once a minute, with the count of those of this event held back."""
        held = self._repeats.tell(event, self._clock())
        if held is not None:
            self.trouble(event, level, **fields, held_back=held or None)

    def _dropped(self, count: int) -> bytes:
        return self._format.line(self._clock(), "warning", "log_dropped", {"lines": count})


class RecordHandler(logging.Handler):
    """Gives records of the logging module to an `EventLog`.

    Of an exception that says what is wrong the line is enough; a traceback comes with bugs only.
    The same warning comes once a minute.
    """

    def __init__(
        self, log: EventLog, expected: tuple[type[BaseException], ...] = (SwingsError, OSError)
    ) -> None:
        super().__init__(logging.INFO)
        self._log = log
        self._expected = expected
        self._repeats = Repeats()

    def emit(self, record: logging.LogRecord) -> None:
        try:
            message = record.getMessage()
        except Exception:
            message = f"{record.msg} (with the wrong arguments)"
        error = record.exc_info[1] if record.exc_info else None
        fields: dict[str, Value] = {"logger": record.name, "message": message}
        if error is not None and not isinstance(error, self._expected):
            fields["traceback"] = "".join(traceback.format_exception(error)).rstrip()
        elif error is not None:
            fields["error"] = f"{type(error).__name__}: {error}"
        level = record.levelname.lower()
        if record.levelno < logging.WARNING:
            self._log.event("record", **fields)
            return
        held = self._repeats.tell(f"{record.name} {message}", record.created)
        if held is not None:
            self._log.trouble("record", level, **fields, held_back=held or None)


def take_over_logging(handler: RecordHandler) -> None:
    """From now on all records go to `handler`, once each, and nowhere else."""
    root = logging.getLogger()
    for other in root.handlers[:]:
        root.removeHandler(other)
    root.addHandler(handler)
    root.setLevel(min(root.level, logging.INFO))
