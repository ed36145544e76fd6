"""The Range header (RFC 9110, section 14) for one range of bytes; everything else is ignored."""

from __future__ import annotations

import re
from dataclasses import dataclass
from enum import Enum

_SINGLE = re.compile(r"bytes=[ \t]*([0-9]*)-([0-9]*)[ \t]*", re.IGNORECASE)

MAX_DIGITS = 19
"""Digits read of a position: more than any object has bytes."""


class Unsatisfiable(Enum):
    """The range is well formed but holds no byte: 416."""

    UNSATISFIABLE = "unsatisfiable"


UNSATISFIABLE = Unsatisfiable.UNSATISFIABLE


@dataclass(frozen=True, slots=True)
class ByteRange:
    """Bytes start..stop-1, at least one."""

    start: int
    stop: int


def parse_range(header: str | None, size: int) -> ByteRange | Unsatisfiable | None:
    """The range that `header` asks of `size` bytes; None where all bytes are to be sent.

    A header that is malformed, of another unit or of several ranges counts as absent, as the RFC
    allows.
    """
    match = _SINGLE.fullmatch(header) if header else None
    if match is None:
        return None
    first, last = match.groups()
    if max(len(first), len(last)) > MAX_DIGITS or not (first or last):
        return None
    if not first:
        count = min(int(last), size)
        return ByteRange(size - count, size) if count else UNSATISFIABLE
    if last and int(last) < int(first):
        return None
    if int(first) >= size:
        return UNSATISFIABLE
    return ByteRange(int(first), min(int(last) + 1, size) if last else size)
