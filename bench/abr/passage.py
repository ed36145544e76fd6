"""A link as bytes that have passed: what can come by when, whatever is sent.

Rule: where a link's latency falls, what is sent later may come earlier. So both ways between the
passing of a byte and its coming are bounds that hold for all that anybody sends.
"""

from __future__ import annotations

import math
from bisect import bisect_left, bisect_right
from itertools import accumulate

from server.abr.link import Link


class Passage:
    """A link from time 0 on. Counts bytes that have passed if it is never idle."""

    def __init__(self, link: Link) -> None:
        steps = link.steps
        self._times_s = [0.0, *accumulate(step.duration_s for step in steps)]
        self._bytes = [0.0, *accumulate(step.duration_s * step.rate_bps / 8 for step in steps)]
        self._latencies_s = [step.latency_s for step in steps]
        self._even = min(self._latencies_s) == max(self._latencies_s)

    def bytes_by(self, time_s: float) -> float:
        """Bytes that have passed by `time_s`; 0 before time 0."""
        if time_s <= 0:
            return 0.0
        times_s, passed = self._times_s, self._bytes
        rounds, into_s = divmod(time_s, times_s[-1])
        n = min(bisect_right(times_s, into_s), len(times_s) - 1)
        share = (into_s - times_s[n - 1]) / (times_s[n] - times_s[n - 1])
        return rounds * passed[-1] + passed[n - 1] + share * (passed[n] - passed[n - 1])

    def earliest_s(self, num_bytes: float) -> float:
        """When `num_bytes` have passed."""
        if num_bytes <= 0:
            return 0.0
        # The last byte of a round passes within it, not when the next one begins.
        rounds = max(0, math.ceil(num_bytes / self._bytes[-1]) - 1)
        left = min(num_bytes - rounds * self._bytes[-1], self._bytes[-1])
        return self._time_s(rounds, left, max(1, bisect_left(self._bytes, left)))

    def latest_s(self, num_bytes: float) -> float:
        """Until when no more than `num_bytes` have passed; below 0 bytes a time before 0."""
        if num_bytes < 0:
            return -math.inf
        rounds, left = divmod(num_bytes, self._bytes[-1])
        return self._time_s(int(rounds), left, min(bisect_right(self._bytes, left), self._last))

    @property
    def _last(self) -> int:
        return len(self._bytes) - 1

    def _time_s(self, rounds: int, left: float, n: int) -> float:
        """The time in step n-1 of a round at which `left` bytes of the round have passed."""
        before, after = self._bytes[n - 1], self._bytes[n]
        share = (left - before) / (after - before) if after > before else 0.0
        start_s = self._times_s[n - 1]
        return rounds * self._times_s[-1] + start_s + share * (self._times_s[n] - start_s)

    def comes_s(self, passed_s: float) -> float:
        """The earliest at which something has come that passes at `passed_s` or later."""
        if self._even:
            return passed_s + self._latencies_s[0]
        number, end_s = self._step(passed_s)
        best_s = passed_s + self._latencies_s[number]
        while end_s < best_s:
            number = (number + 1) % len(self._latencies_s)
            best_s = min(best_s, end_s + self._latencies_s[number])
            end_s += self._times_s[number + 1] - self._times_s[number]
        return best_s

    def passed_s(self, comes_s: float) -> float:
        """The latest at which something passed that has come by `comes_s`."""
        if self._even or comes_s <= 0:
            return comes_s - self._latencies_s[0]
        number, end_s = self._step(comes_s)
        while end_s > 0:
            start_s = end_s - (self._times_s[number + 1] - self._times_s[number])
            latest_s = min(end_s, comes_s - self._latencies_s[number])
            if latest_s >= start_s - 1e-9:
                return latest_s
            number, end_s = (number - 1) % len(self._latencies_s), start_s
        return -math.inf

    def _step(self, time_s: float) -> tuple[int, float]:
        """(number of the step at `time_s`, when it ends)."""
        rounds, into_s = divmod(max(0.0, time_s), self._times_s[-1])
        number = min(bisect_right(self._times_s, into_s) - 1, len(self._latencies_s) - 1)
        return number, rounds * self._times_s[-1] + self._times_s[number + 1]
