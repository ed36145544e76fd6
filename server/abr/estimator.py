"""How fast a connection carries bytes, from what was acknowledged while something waited to be.

Rule: only busy time counts, so that pacing never looks like a slow link, and a spell of it begins
with the latency of the link, which is not throughput.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass

from codec.errors import InvalidError

MANY_WINDOWS = 20
"""Windows after which a sample goes, however few bytes have come since."""


@dataclass(frozen=True, slots=True)
class EstimatorConfig:
    """Samples and window of the rate estimate."""

    window_s: float = 0.4
    """Window of the estimate in seconds; longer if it holds less than min_bytes. Old samples say
    little about a link that has changed."""
    sample_s: float = 0.02
    """Busy seconds in one sample; fewer if min_bytes are acknowledged sooner."""
    min_bytes: int = 16 * 1024
    """Minimum bytes in an estimate; fewer bytes measure buffers rather than the link."""

    def __post_init__(self) -> None:
        for name in ("window_s", "sample_s", "min_bytes"):
            if not getattr(self, name) > 0:
                raise InvalidError(f"{name} is {getattr(self, name)}; it must be positive")


class RateEstimator:
    """Bytes over busy time, within a short window."""

    def __init__(self, config: EstimatorConfig | None = None) -> None:
        self._config = config or EstimatorConfig()
        self.rate_bps: float | None = None
        """The estimate in bits per second; None until enough was acknowledged."""
        self._samples: deque[tuple[float, float, float]] = deque()  # bytes, busy and idle seconds
        self._bytes = 0.0
        self._busy_s = 0.0
        self._idle_s = 0.0
        self._open = (0.0, 0.0, 0.0)

    def add(self, num_bytes: float, busy_s: float, idle_s: float = 0.0) -> None:
        """Takes in that `num_bytes` were acknowledged during `busy_s` seconds, after `idle_s`
        seconds of which nothing is known."""
        config = self._config
        open_bytes, open_busy_s, open_idle_s = self._open
        self._open = (open_bytes + num_bytes, open_busy_s + busy_s, open_idle_s + idle_s)
        if self._open[0] < config.min_bytes and self._open[1] < config.sample_s:
            return
        self._samples.append(self._open)
        self._bytes += self._open[0]
        self._busy_s += self._open[1]
        self._idle_s += self._open[2]
        self._open = (0.0, 0.0, 0.0)
        while self._is_enough_without_the_first():
            old_bytes, old_busy_s, old_idle_s = self._samples.popleft()
            self._bytes -= old_bytes
            self._busy_s -= old_busy_s
            self._idle_s -= old_idle_s
        known = self._bytes >= config.min_bytes or self.rate_bps is not None
        if known and self._busy_s > 0:
            self.rate_bps = max(1.0, 8 * self._bytes / self._busy_s)

    def _is_enough_without_the_first(self) -> bool:
        if len(self._samples) < 2:
            return False
        first_bytes, first_busy_s, first_idle_s = self._samples[0]
        rest_bytes, rest_s = self._bytes - first_bytes, self._busy_s - first_busy_s
        if rest_s >= MANY_WINDOWS * self._config.window_s:
            return True
        rest_s += self._idle_s - first_idle_s
        return rest_s >= self._config.window_s and rest_bytes >= self._config.min_bytes
