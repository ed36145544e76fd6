"""The throughput rule: the most layers that the link carries, with something kept back.

Where dash.js takes the less of two moving averages with half lives of 3 s and 8 s, this goes by the
estimate as it is. The session's looks back 0.4 s already, decisions are ten times as frequent, and
with a lead of 6 s every second of delay in reacting costs more than a wrong step.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from codec.errors import InvalidError

from .situation import Situation


@dataclass(frozen=True, slots=True)
class ThroughputRule:
    """Goes by the link alone, whatever the lead."""

    safety: float = 0.9
    """Share of the estimated rate that is planned with (dash.js, Sabre)."""
    rise_s: float = 4.0
    """Seconds over which the snapshots that a rise takes are spread (ours)."""

    horizon: ClassVar[int] = 1

    def __post_init__(self) -> None:
        for name in ("safety", "rise_s"):
            if not getattr(self, name) > 0:
                raise InvalidError(f"{name} is {getattr(self, name)}; it must be positive")

    def choose_layers(self, situation: Situation) -> int:
        if not situation.measured:
            return 1
        rate_bps = self.safety * situation.rate_bps
        counts = range(situation.most_layers, 1, -1)
        return next((n for n in counts if situation.need_bps(n, self.rise_s) <= rate_bps), 1)
