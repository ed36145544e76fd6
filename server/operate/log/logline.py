"""One event as one line: JSON, or key=value for people.

Rule: a line is printable ASCII and ends with the only newline in it. No clock, no files.
"""

from __future__ import annotations

import json
import math
import re
import time
from collections.abc import Mapping
from enum import StrEnum
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

_encode = json.JSONEncoder(separators=(",", ":")).encode


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
        self._second = -1
        self._second_text = ""

    def line(self, time_s: float, level: str, event: str, fields: Mapping[str, Value]) -> bytes:
        """The line of one event. time_s: Unix time. level, event, keys: our own words."""
        stamp = self._stamp(time_s)
        line = self._line(stamp, level, event, fields, MAX_TEXT)
        if len(line) > MAX_LINE_BYTES:
            line = self._line(stamp, level, event, fields, SHORT_TEXT)
        return line

    def _line(
        self, stamp: str, level: str, event: str, fields: Mapping[str, Value], max_text: int
    ) -> bytes:
        kept = {}
        for key, value in fields.items():
            if value is None:
                continue
            if isinstance(value, str):
                limit = MAX_LONG_TEXT if key == LONG else max_text
                if len(value) > limit:
                    value = value[: limit - 3] + "..."
            elif isinstance(value, float):
                value = round(value, 6) if math.isfinite(value) else str(value)
            kept[key] = value
        if self._json:
            head = f'{{"time":"{stamp}","level":"{level}","event":"{event}"'
            tail = "," + _encode(kept)[1:] if kept else "}"
            return f"{head}{tail}\n".encode("ascii")
        words = [stamp, level, event]
        for key, value in kept.items():
            if isinstance(value, str):
                text = value if _BARE.fullmatch(value) else encode_basestring_ascii(value)
            elif isinstance(value, bool):
                text = "true" if value else "false"
            else:
                text = str(value)
            words.append(f"{key}={text}")
        return (" ".join(words) + "\n").encode("ascii")

    def _stamp(self, time_s: float) -> str:
        milliseconds = int(time_s * 1000)
        second = milliseconds // 1000
        if second != self._second:
            self._second = second
            self._second_text = time.strftime("%Y-%m-%dT%H:%M:%S", time.gmtime(second))
        return f"{self._second_text}.{milliseconds % 1000:03d}Z"
