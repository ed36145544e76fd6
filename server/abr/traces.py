"""Traces of real links, as bytes. Two forms are recognised by their content:

* a JSON list of steps, which is also the form of Sabre's traces:
  [{"duration_ms": 500, "bandwidth_kbps": 2000, "latency_ms": 20}, ...]
* Mahimahi's text: each line is the millisecond at which 1504 bytes can pass, never less than the
  line before; after the last one the trace begins again.
"""

from __future__ import annotations

import json
import math
import re
from io import BytesIO
from typing import Any

from codec.errors import InvalidError

from .link import Link, LinkStep

MAX_TRACE_BYTES = 64 << 20

CHANCE_BYTES = 1504
"""Bytes carried per line of a Mahimahi trace. Its manual says 1500, its code and its logs 1504."""

STEP_MS = 100
"""The lines of Mahimahi's text are gathered into steps as long as this, milliseconds."""

_MAX_DIGITS = 12
_KEYS = ("duration_ms", "bandwidth_kbps", "latency_ms")


def parse_trace(data: bytes, name: str, latency_s: float = 0.0) -> Link:
    """The link that the trace `data` describes. Raises InvalidError, which says `name`.

    latency_s: that of a trace which says none, as Mahimahi's.
    """
    try:
        if len(data) > MAX_TRACE_BYTES:
            raise InvalidError(f"the file has more than {MAX_TRACE_BYTES >> 20} MiB; shorten it")
        if re.match(rb"\s*[0-9]", data):
            return Link(_text_steps(data, latency_s))
        return Link(_json_steps(data))
    except InvalidError as error:
        raise InvalidError(f"trace {name}: {error}") from error


def scaled(link: Link, factor: float) -> Link:
    """`link` with all rates times `factor`; when it changes and its latency stay as they are."""
    if not (math.isfinite(factor) and factor > 0):
        raise InvalidError(f"scale factor is {factor}; give a number over 0")
    return Link(
        [LinkStep(step.duration_s, step.rate_bps * factor, step.latency_s) for step in link.steps]
    )


def _json_steps(data: bytes) -> list[LinkStep]:
    try:
        value = json.loads(data)
    except (ValueError, RecursionError) as error:
        raise InvalidError(f"the file is not JSON nor lines of milliseconds: {error}") from error
    if not isinstance(value, list) or not value:
        raise InvalidError("the file is not a list of steps")
    return [_json_step(entry, number) for number, entry in enumerate(value)]


def _json_step(entry: Any, number: int) -> LinkStep:
    values: list[float] = []
    for key in _KEYS:
        value: Any = entry.get(key) if isinstance(entry, dict) else None
        if type(value) not in (int, float):
            raise InvalidError(f"step {number} must have the numbers {', '.join(_KEYS)}")
        try:
            values.append(float(value))
        except OverflowError as error:
            raise InvalidError(f"step {number}: {key} is too large") from error
    duration_ms, bandwidth_kbps, latency_ms = values
    return LinkStep(duration_ms / 1000, bandwidth_kbps * 1000, latency_ms / 1000)


def _text_steps(data: bytes, latency_s: float) -> list[LinkStep]:
    chances: dict[int, int] = {}  # how many in each step that has some; in order of time
    last_ms = 0
    for number, line in enumerate(BytesIO(data.rstrip()), 1):
        word = line.strip()
        if not word.isdigit() or len(word) > _MAX_DIGITS:
            shown = word[:20].decode("ascii", "replace")
            raise InvalidError(f"line {number} is {shown!r}, not a whole number of milliseconds")
        time_ms = int(word)
        if time_ms < last_ms:
            raise InvalidError(f"line {number} is {time_ms} ms, after {last_ms} ms; sort the lines")
        last_ms = time_ms
        # What passes at the very end of a step belongs to it, for there the trace ends, too.
        place = max(0, time_ms - 1) // STEP_MS
        chances[place] = chances.get(place, 0) + 1
    if last_ms == 0:
        raise InvalidError("the last line is 0 ms; it must be later")
    steps: list[LinkStep] = []
    end_ms = 0
    for place, count in chances.items():
        begin_ms = place * STEP_MS
        if begin_ms > end_ms:
            steps.append(LinkStep((begin_ms - end_ms) / 1000, 0.0, latency_s))
        end_ms = min(begin_ms + STEP_MS, last_ms)
        duration_s = (end_ms - begin_ms) / 1000
        steps.append(LinkStep(duration_s, count * CHANCE_BYTES * 8 / duration_s, latency_s))
    return steps
