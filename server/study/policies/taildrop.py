"""The paper SwinGS's own (section 5.5): the least opaque Gaussians are dropped to fit the rate.

All layers are sent as long as the link carries them; else the tail of each slice is left out. A
layer is all or nothing, and after it is left out once it is gone until the next segment. The
paper's demonstration knows the rate; here it is what was measured, and a little is kept back of it,
or there would never be a lead.
"""

from __future__ import annotations

from dataclasses import dataclass

from codec.errors import InvalidError

from .situation import Situation


@dataclass(frozen=True, slots=True)
class TailDropConfig:
    """Settings of a `TailDropRule`."""

    share: float = 0.9
    """Share of the measured rate (the paper fits all of it)."""

    def __post_init__(self) -> None:
        if not self.share > 0:
            raise InvalidError(f"share is {self.share}; it must be positive")


class TailDropRule:
    """Goes by the rate of this moment, slice by slice."""

    horizon = 1

    def __init__(self, config: TailDropConfig | None = None) -> None:
        self._config = config or TailDropConfig()

    def choose_layers(self, situation: Situation) -> int:
        group = situation.group
        if not situation.measured:
            return 1
        budget_bytes = self._config.share * situation.rate_bps * group.media_s / 8
        counts = range(situation.most_layers, 1, -1)
        return next((n for n in counts if group.slice_bytes[n - 1] <= budget_bytes), 1)
