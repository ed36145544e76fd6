"""The Range header (RFC 9110, section 14) for one range of bytes; everything else is ignored."""

from __future__ import annotations

import re

_SINGLE = re.compile(r"bytes=[ \t]*([0-9]*)-([0-9]*)[ \t]*", re.IGNORECASE)

MAX_DIGITS = 19
"""Digits read of a position: more than any object has bytes."""


def parse_range(header: str, size: int) -> range | None:
    """The range that `header` asks of `size` bytes, empty where it holds none of them: 416. None
    where all bytes are to be sent.

    A header that is malformed, of another unit or of several ranges counts as absent, as the RFC
    allows.
    """
    match = _SINGLE.fullmatch(header)
    if match is None:
        return None
    first, last = match.groups()
    if max(len(first), len(last)) > MAX_DIGITS or not (first or last):
        return None
    if not first:
        return range(max(0, size - int(last)), size)
    if last and int(last) < int(first):
        return None
    return range(int(first), min(int(last) + 1, size) if last else size)
