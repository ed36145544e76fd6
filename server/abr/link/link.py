"""A network link as numbers: how long bytes take to pass. relay.py makes it real.

A link is written as a rate, `8M` (bits per second; k, M, G), a rate and a latency, `8M,20ms`, or
the name of a trace, a JSON file of steps:

    [{"duration_ms": 500, "bandwidth_kbps": 2000, "latency_ms": 20}, ...]
"""

from __future__ import annotations

import json
import math
import re
from bisect import bisect_right
from dataclasses import dataclass
from itertools import accumulate
from pathlib import Path
from typing import Any

from codec.errors import InvalidError

MAX_TRACE_BYTES = 64 << 20

_RATE = re.compile(r"(\d+(?:\.\d+)?)([kMG]?)(?:,(\d+(?:\.\d+)?)ms)?")
_PREFIXES = {"": 1.0, "k": 1e3, "M": 1e6, "G": 1e9}


@dataclass(frozen=True, slots=True)
class LinkStep:
    """The link for a while."""

    duration_s: float
    rate_bps: float
    latency_s: float
    """Added to what comes from the server, so once to each round trip."""


class Link:
    """Steps one after another; after the last one the first follows again."""

    def __init__(self, steps: list[LinkStep]) -> None:
        for number, step in enumerate(steps):
            values = (step.duration_s, step.rate_bps, step.latency_s)
            if not all(math.isfinite(x) and x >= 0 for x in values) or not step.duration_s:
                raise InvalidError(f"link: step {number} is {values}, in s, bit/s, s")
        self.steps = steps
        self._ends_s = list(accumulate(step.duration_s for step in steps))
        self._round_bits = sum(step.duration_s * step.rate_bps for step in steps)
        if self._round_bits == 0:
            raise InvalidError("link: nothing ever passes; every rate is 0")
        if self._round_bits == math.inf:
            raise InvalidError("link: the rates and durations are too large")

    @staticmethod
    def parse(text: str) -> Link:
        """The link that `text` describes, see above. Raises InvalidError."""
        if text.endswith(".json"):
            return _read_trace(Path(text))
        match = _RATE.fullmatch(text)
        if not match:
            raise InvalidError(
                f"link {text!r} is neither a rate such as 8M or 8M,20ms nor a .json trace"
            )
        rate_bps = float(match[1]) * _PREFIXES[match[2]]
        return Link([LinkStep(3600.0, rate_bps, float(match[3] or 0) / 1000)])

    def at(self, time_s: float) -> LinkStep:
        """The step that holds at `time_s`."""
        return self.steps[self._place(time_s)[0]]

    def _place(self, time_s: float) -> tuple[int, float]:
        """(number of the step at `time_s`, what is left of it in seconds)."""
        into_s = time_s % self._ends_s[-1]
        number = min(bisect_right(self._ends_s, into_s), len(self.steps) - 1)
        return number, self._ends_s[number] - into_s

    def passed_s(self, start_s: float, num_bytes: int) -> float:
        """When the last of `num_bytes` has passed, if the first one begins at `start_s`."""
        bits = 8.0 * num_bytes
        # Whole rounds at once, but never the last one: its end counts, not that of a silent step.
        rounds = max(0, math.ceil(bits / self._round_bits) - 1)
        bits -= rounds * self._round_bits
        time_s = start_s + rounds * self._ends_s[-1]
        number, left_s = self._place(time_s)
        while bits > self.steps[number].rate_bps * left_s:
            bits -= self.steps[number].rate_bps * left_s
            time_s += left_s
            number = (number + 1) % len(self.steps)
            left_s = self.steps[number].duration_s
        return time_s + (bits / self.steps[number].rate_bps if bits else 0.0)


def _read_trace(path: Path) -> Link:
    try:
        with open(path, "rb") as file:
            value = json.loads(file.read(MAX_TRACE_BYTES))
    except OSError as error:
        raise InvalidError(f"link: trace {path}: {error.strerror}") from error
    except (ValueError, RecursionError) as error:
        raise InvalidError(f"link: trace {path} is not JSON: {error}") from error
    if not isinstance(value, list) or not value:
        raise InvalidError(f"link: trace {path} is not a list of steps")
    try:
        return Link([_step(entry, number) for number, entry in enumerate(value)])
    except InvalidError as error:
        raise InvalidError(f"trace {path}: {error}") from error


def _step(entry: Any, number: int) -> LinkStep:
    keys = ("duration_ms", "bandwidth_kbps", "latency_ms")
    values: list[float] = []
    for key in keys:
        value: Any = entry.get(key) if isinstance(entry, dict) else None
        if type(value) not in (int, float):
            raise InvalidError(f"link: step {number} does not hold the numbers {', '.join(keys)}")
        values.append(float(value))
    duration_ms, bandwidth_kbps, latency_ms = values
    return LinkStep(duration_ms / 1000, bandwidth_kbps * 1000, latency_ms / 1000)
