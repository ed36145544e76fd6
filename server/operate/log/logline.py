"""A formatter that writes a log record as one line: JSON, or key=value for people.

Rule: a line is printable ASCII of at most MAX_LINE_BYTES. Its keys are ours; its values may come
from strangers.
"""

from __future__ import annotations

import json
import logging
import math
import re
import traceback
from collections.abc import Mapping
from enum import StrEnum
from functools import lru_cache
from time import gmtime, strftime

from codec.errors import SwingsError

Value = str | int | float | bool | None
"""A field of an event; None leaves it out."""

MAX_LINE_BYTES = 4095
"""With its newline a line fits into one piece of a pipe, which workers share."""

CUTS = ((512, 3000), (48, 384))
"""Characters kept of each text, and of a traceback; the second pair for lines that are too long.
A character may take six bytes."""

_BARE = re.compile(r"[!#-<>-\[\]-~]+")
"""Text that needs no quotes: printable, without a space, a quote, = or a backslash."""

MAX_QUOTED = 1024
"""Texts of which it is remembered how they look in a line."""


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
        self._quote = _json if self._is_json else _plain
        self._pair = '"{}":{}'.format if self._is_json else "{}={}".format
        self._second = -1
        self._time = ""  # that second

    def format(self, record: logging.LogRecord) -> str:
        """The line without its newline."""
        level = record.levelname.lower()
        return self.line(record.created, level, "record", _fields_of(record))

    def line(self, created_s: float, level: str, event: str, fields: Mapping[str, Value]) -> str:
        """The line of an event at `created_s`, Unix seconds."""
        second, milliseconds = divmod(int(1000 * created_s), 1000)
        if second != self._second:
            self._second = second
            self._time = strftime("%Y-%m-%dT%H:%M:%S", gmtime(second))
        line = ""
        for max_text, max_traceback in CUTS:
            texts = []
            for key, value in fields.items():
                if value is None:
                    continue
                if isinstance(value, str):
                    if len(value) > max_text:
                        value = _cut(key, value, max_text, max_traceback)
                    text = self._quote(value)
                else:
                    text = str(value) if type(value) is int else self._number(value)
                texts.append(self._pair(key, text))
            line = self._join(f"{self._time}.{milliseconds:03d}Z", level, event, texts)
            if len(line) <= MAX_LINE_BYTES:
                break
        return line

    def _number(self, value: float | bool) -> str:
        """As JSON has it."""
        if isinstance(value, bool):
            return "true" if value else "false"
        return str(round(value, 6)) if math.isfinite(value) else self._quote(str(value))

    def _join(self, time: str, level: str, event: str, pairs: list[str]) -> str:
        if self._is_json:
            head = f'"time":"{time}","level":"{level}","event":{_json(event)}'
            return f"{{{','.join((head, *pairs))}}}"
        return " ".join((time, level, event, *pairs))


def message_of(record: logging.LogRecord) -> str:
    """The message of a record, even if its arguments do not fit it."""
    try:
        return record.getMessage()
    except Exception:
        return f"{record.msg} (with the wrong arguments)"


def _fields_of(record: logging.LogRecord) -> dict[str, Value]:
    """The fields of a record of the logging module. An exception that names its cause needs no
    traceback; others are bugs."""
    fields: dict[str, Value] = {"logger": record.name, "message": message_of(record)}
    error = record.exc_info[1] if record.exc_info else None
    if isinstance(error, SwingsError | OSError):
        fields["error"] = f"{type(error).__name__}: {error}"
    elif error is not None:
        fields["traceback"] = "".join(traceback.format_exception(error)).rstrip()
    fields["held_back"] = getattr(record, "held_back", None)
    return fields


def _cut(key: str, text: str, max_text: int, max_traceback: int) -> str:
    """A long text without its end; a traceback without its beginning, as it ends with the error."""
    if key != "traceback":
        return f"{text[: max_text - 3]}..."
    return text if len(text) <= max_traceback else f"...{text[3 - max_traceback :]}"


# Addresses, methods and paths come again and again.
@lru_cache(MAX_QUOTED)
def _json(text: str) -> str:
    return json.dumps(text)


@lru_cache(MAX_QUOTED)
def _plain(text: str) -> str:
    return text if _BARE.fullmatch(text) else json.dumps(text)
