"""A network link as numbers: how long bytes take to pass. traces.py reads one, generate.py makes
one up, and the player's relay makes it real."""

from __future__ import annotations

import math
from bisect import bisect_left, bisect_right
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import accumulate

from codec.errors import InvalidError


@dataclass(frozen=True, slots=True)
class LinkStep:
    """The link for a while."""

    duration_s: float
    """Over 0, seconds."""
    rate_bps: float
    """Throughput, bits per second; 0 is an outage."""
    latency_s: float
    """Added to what comes from the server, so once to each round trip, seconds."""


class Link:
    """Steps one after another; after the last one the first follows again."""

    __slots__ = (
        "_begins_s",
        "_bits",
        "_ends_s",
        "_last",
        "_rates_bps",
        "_round_bits",
        "mean_bps",
        "round_s",
        "steps",
    )

    def __init__(self, steps: Sequence[LinkStep]) -> None:
        for number, step in enumerate(steps):
            values = (step.duration_s, step.rate_bps, step.latency_s)
            if not all(math.isfinite(x) and x >= 0 for x in values) or not step.duration_s:
                raise InvalidError(
                    f"link: step {number} is {values}, in s, bit/s, s; "
                    "give 0 or more, and a duration over 0"
                )
        self.steps = tuple(steps)
        self._last = len(steps) - 1
        self._rates_bps = [step.rate_bps for step in steps]
        # accumulate, not sum: newer Pythons add up differently.
        self._begins_s = list(accumulate((step.duration_s for step in steps), initial=0.0))
        self._ends_s = self._begins_s[1:]
        bits = (step.duration_s * step.rate_bps for step in steps)
        self._bits = list(accumulate(bits, initial=0.0))
        """Bits carried since the round began, at the start of each step and at the end of the
        last."""
        self._round_bits = self._bits[-1]
        self.round_s = self._begins_s[-1]
        """All steps together, seconds."""
        if math.inf in (self._round_bits, self.round_s):
            raise InvalidError("link: the rates and durations are too large")
        if self._round_bits == 0:
            raise InvalidError("link: every rate is 0; raise at least one")
        if self._round_bits < 1:
            raise InvalidError("link: all steps together carry less than one bit; raise the rates")
        self.mean_bps = self._round_bits / self.round_s
        """Mean throughput, outages included, bits per second."""

    def at(self, time_s: float) -> LinkStep:
        """The step that holds at `time_s`."""
        number = bisect_right(self._ends_s, time_s % self.round_s)
        # The remainder of a time just below 0 is rounded up to a whole round.
        return self.steps[number if number <= self._last else self._last]

    def passed_s(self, start_s: float, num_bytes: float) -> float:
        """When the last of `num_bytes` has passed, if the first one begins at `start_s`."""
        bits = 8.0 * num_bytes
        if not bits:
            return start_s
        into_s = start_s % self.round_s
        number = bisect_right(self._ends_s, into_s)
        if number > self._last:
            number = self._last
        rate_bps = self._rates_bps[number]
        if bits <= rate_bps * (self._ends_s[number] - into_s):
            return start_s + bits / rate_bps
        rounds = 0.0
        if bits > self._round_bits:
            # Whole rounds at once, but never the last: its end counts, not that of a silent step.
            rounds, bits = divmod(bits, self._round_bits)
            if not bits:
                rounds, bits = rounds - 1, self._round_bits
        # From here on all bits since the round began, so that one search finds the last one's step.
        bits += self._bits[number] + rate_bps * (into_s - self._begins_s[number])
        if bits > self._round_bits:
            rounds, bits = rounds + 1, bits - self._round_bits
        number = bisect_left(self._bits, bits, 1) - 1
        lasts_s = (bits - self._bits[number]) / self._rates_bps[number]
        end_s = min(self._begins_s[number] + lasts_s, self._ends_s[number])
        return max(start_s, start_s - into_s + rounds * self.round_s + end_s)

    def capacity_bytes(self, start_s: float, end_s: float) -> float:
        """Bytes carried from `start_s` to `end_s`; the inverse of `passed_s`."""
        first_round, first_bits = self._passed_bits(start_s)
        last_round, last_bits = self._passed_bits(end_s)
        bits = (last_round - first_round) * self._round_bits + last_bits - first_bits
        return max(0.0, bits) / 8

    def _passed_bits(self, time_s: float) -> tuple[float, float]:
        """(whole rounds before `time_s`, bits of its own round that passed before it)."""
        rounds, into_s = divmod(time_s, self.round_s)
        number = min(bisect_right(self._ends_s, into_s), self._last)
        into_step_s = into_s - self._begins_s[number]
        return rounds, self._bits[number] + self._rates_bps[number] * into_step_s
