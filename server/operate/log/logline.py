"""One event as one line: JSON, or key=value for people.

Rule: a line is printable ASCII and ends with the only newline in it. No clock, no files.
"""

from __future__ import annotations

import math
import re
import time
from collections.abc import Iterator, Mapping
from enum import StrEnum
from functools import lru_cache
from json.encoder import encode_basestring_ascii

Value = str | int | float | bool | None
"""What a field may hold; None leaves it out."""

MAX_TEXT = 512
"""Characters kept of a field."""

MAX_LINE_BYTES = 4096
"""Bytes of a line above which its fields are cut more: as much as a pipe takes in one piece."""

SHORT_TEXT = 48
"""Characters then kept of a field. Each may take six bytes."""

LONG = "traceback"
"""The field that may have more of them."""

MAX_LONG_TEXT = 8192

_BARE = re.compile(r"[!#-<>-\[\]-~]+")
"""Text that needs no quotes: printable, without a space, a quote, = or a backslash."""

_TIME = "TIME"
"""Stands for the time in what is remembered of a line."""

REMEMBERED_CHARS = 128
REMEMBERED_TEXTS = 4096


@lru_cache(maxsize=REMEMBERED_TEXTS)
def _json_text(value: str) -> str:
    return encode_basestring_ascii(value)


@lru_cache(maxsize=REMEMBERED_TEXTS)
def _plain_text(value: str) -> str:
    return value if _BARE.fullmatch(value) else encode_basestring_ascii(value)


class LogStyle(StrEnum):
    """How lines look."""

    JSON = "json"
    """One JSON object a line."""
    PLAIN = "plain"
    """Time, level and event, then key=value."""


class LineFormat:
    """Makes lines of one style."""

    def __init__(self, style: LogStyle) -> None:
        self._json = style is LogStyle.JSON
        self._remembered = lru_cache(REMEMBERED_TEXTS)(self._around)
        self._second = -1
        self._second_text = ""

    def line(self, time_s: float, level: str, event: str, fields: Mapping[str, Value]) -> bytes:
        """The line of one event. time_s: Unix time. level, event, keys: our own words."""
        stamp = self._stamp(time_s)
        line = self._line(stamp, level, event, fields, MAX_TEXT)
        if len(line) > MAX_LINE_BYTES:
            line = self._line(stamp, level, event, fields, SHORT_TEXT)
        return line

    def often(
        self,
        time_s: float,
        event: str,
        texts: tuple[tuple[str, str], ...],
        numbers: Mapping[str, int | float],
    ) -> bytes:
        """The line, of level info, of an event that comes often and with the same texts."""
        begin, head, end = self._remembered(event, texts)
        if self._json:
            inside = "".join([f',"{key}":{value}' for key, value in numbers.items()])
        else:
            inside = "".join([f" {key}={value}" for key, value in numbers.items()])
        return f"{begin}{self._stamp(time_s)}{head}{inside}{end}".encode("ascii")

    def _line(
        self, stamp: str, level: str, event: str, fields: Mapping[str, Value], max_text: int
    ) -> bytes:
        words = self._words(fields, max_text)
        if self._json:
            inside = "".join(f',"{key}":{text}' for key, text in words)
            line = f'{{"time":"{stamp}","level":"{level}","event":"{event}"{inside}}}\n'
        else:
            inside = "".join(f" {key}={text}" for key, text in words)
            line = f"{stamp} {level} {event}{inside}\n"
        return line.encode("ascii")

    def _around(self, event: str, texts: tuple[tuple[str, str], ...]) -> tuple[str, str, str]:
        """What stands before the time of a line, behind it, and behind the numbers at its end."""
        line = self._line(_TIME, "info", event, dict(texts), MAX_TEXT).decode()
        begin, _, rest = line.partition(_TIME)
        end = "}\n" if self._json else "\n"
        return begin, rest.removesuffix(end), end

    def _words(self, fields: Mapping[str, Value], max_text: int) -> Iterator[tuple[str, str | int]]:
        text_of = _json_text if self._json else _plain_text
        for key, value in fields.items():
            if type(value) is int:
                yield key, value
            elif isinstance(value, str):
                limit = MAX_LONG_TEXT if key == LONG else max_text
                # Of short texts the same come again and again: addresses, paths.
                find = text_of if len(value) <= REMEMBERED_CHARS else text_of.__wrapped__
                yield key, find(value if len(value) <= limit else value[: limit - 3] + "...")
            elif value is not None:
                yield key, self._number(value)

    def _number(self, value: float | bool) -> str:
        if isinstance(value, float):
            if not math.isfinite(value):
                return f'"{value}"' if self._json else str(value)
            return str(round(value, 6))
        return "true" if value else "false"

    def _stamp(self, time_s: float) -> str:
        milliseconds = int(time_s * 1000)
        second = milliseconds // 1000
        if second != self._second:
            self._second = second
            self._second_text = time.strftime("%Y-%m-%dT%H:%M:%S", time.gmtime(second))
        return f"{self._second_text}.{milliseconds % 1000:03d}Z"
