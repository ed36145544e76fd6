"""How fast a connection carries bytes, from bytes over busy time.

Rule: only time in which something waited to be sent counts, so that pacing never looks like a
slow link; a sample that may hold idle time is a lower bound, and counts only where it raises the
estimate.
"""

from __future__ import annotations

from dataclasses import dataclass, field


@dataclass(frozen=True, slots=True)
class EstimatorConfig:
    """How a `ThroughputEstimator` forgets and what it takes for a sample."""

    short_half_life_s: float = 1.0
    """Seconds after which a sample counts half in the average that follows a drop."""
    long_half_life_s: float = 4.0
    """Seconds after which a sample counts half in the average that distrusts a rise."""
    min_sample_bytes: int = 16 * 1024
    """Bytes gathered into one sample; fewer say more of latency and buffers than of the link."""


@dataclass(slots=True)
class _Average:
    """Bits over busy seconds, both forgotten with the same half-life."""

    half_life_s: float
    bits: float = 0.0
    busy_s: float = 0.0
    updated_s: float = 0.0

    def add(self, now_s: float, bits: float, busy_s: float) -> None:
        kept = 0.5 ** (max(0.0, now_s - self.updated_s) / self.half_life_s)
        self.bits = self.bits * kept + bits
        self.busy_s = self.busy_s * kept + busy_s
        self.updated_s = now_s


@dataclass(slots=True)
class _Sample:
    """A sample in the making."""

    num_bytes: int = 0
    busy_s: float = 0.0
    at_least: bool = False


@dataclass(slots=True)
class ThroughputEstimator:
    """The lower of a short and a long average: quick to believe a drop, slow to believe a rise.

    Old samples fade with the time of day, not with busy time: after a pause new ones soon rule.
    """

    config: EstimatorConfig = field(default_factory=EstimatorConfig)
    rate_bps: float | None = None
    """The estimate in bits per second; None until there was a whole sample."""
    _short: _Average = field(init=False)
    _long: _Average = field(init=False)
    _sample: _Sample = field(init=False, default_factory=_Sample)

    def __post_init__(self) -> None:
        self._short = _Average(self.config.short_half_life_s)
        self._long = _Average(self.config.long_half_life_s)

    def add(self, now_s: float, num_bytes: int, busy_s: float, *, at_least: bool = False) -> None:
        """Takes in `num_bytes` that left during `busy_s`, which ended at `now_s`.

        `at_least`: part of `busy_s` may have been idle, so the true rate may be higher.
        """
        sample = self._sample
        sample.num_bytes += num_bytes
        sample.busy_s += busy_s
        sample.at_least |= at_least
        if sample.num_bytes < self.config.min_sample_bytes or sample.busy_s <= 0:
            return
        self._sample = _Sample()
        bits = 8.0 * sample.num_bytes
        if sample.at_least and self.rate_bps is not None and bits <= self.rate_bps * sample.busy_s:
            return
        self._short.add(now_s, bits, sample.busy_s)
        self._long.add(now_s, bits, sample.busy_s)
        self.rate_bps = min(a.bits / a.busy_s for a in (self._short, self._long))
