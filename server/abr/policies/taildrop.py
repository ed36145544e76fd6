"""The paper SwinGS's own (section 5.5): the least opaque Gaussians are dropped to fit the rate.

All layers are sent as long as the link carries them; else the tail of each slice is left out. A
layer is all or nothing, so where the rate is between two of them slices take turns. Where slots
last (version 2) a layer that is left out once is gone until the next segment, and does not take
turns. The paper's demonstration knows the rate; here it is what was measured, and a little is kept
back of it, or there would never be a lead.
"""

from __future__ import annotations

from dataclasses import dataclass

from codec.errors import InvalidError

from .situation import Situation


@dataclass(frozen=True, slots=True)
class TailDropConfig:
    """What a `TailDropRule` fits slices into."""

    share: float = 0.9
    """Share of the measured rate (the paper fits all of it)."""

    def __post_init__(self) -> None:
        if not self.share > 0:
            raise InvalidError(f"share is {self.share}; it must be positive")


class TailDropRule:
    """Goes by the rate of this moment, slice by slice; without memory but for turns."""

    horizon = 1

    def __init__(self, config: TailDropConfig | None = None) -> None:
        self._config = config or TailDropConfig()
        self._spare_bytes = 0.0
        """What slices before left of what they might have taken."""

    def choose_layers(self, situation: Situation) -> int:
        group = situation.group
        if not situation.measured:
            return 1
        budget = self._config.share * situation.rate_bps * group.media_s / 8 + self._spare_bytes
        counts = range(situation.most_layers, 1, -1)
        layers = next((n for n in counts if group.slice_bytes[n - 1] <= budget), 1)
        if group.can_rise and not any(group.snapshot_bytes):
            # No more is saved or owed than one slice.
            most = group.slice_bytes[-1]
            self._spare_bytes = max(-most, min(most, budget - group.slice_bytes[layers - 1]))
        return layers
