"""How many layers the next slice gets.

Rule: a policy sees one `Situation` and its own state, nothing else; any one fits behind `Policy`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Protocol


@dataclass(frozen=True, slots=True)
class Situation:
    """What is known when the layers of one slice must be chosen."""

    rate_bps: float | None
    """Estimated throughput in bits per second; None while unknown."""
    slice_bytes: tuple[float, ...]
    """Bytes of a slice here with 1, 2, ... layers: rising, one entry for each layer count."""
    frame_s: float
    """Seconds that a frame shows: one slice is due in each."""
    lead_s: float
    """Seconds of media that the client holds beyond the frame it shows. While the first window is
    incomplete: the seconds left until the first picture ought to be there."""
    goal_lead_s: float
    """The most lead that can be had now: the target, or less where a live stream has no more."""
    missing_slices: int = 0
    """Slices that the first window still lacks; 0 once the client plays."""

    @property
    def num_layers(self) -> int:
        return len(self.slice_bytes)

    def need_bps(self, num_layers: int) -> float:
        """What `num_layers` layers ask of the link, slice after slice."""
        return 8 * self.slice_bytes[num_layers - 1] / self.frame_s


class Policy(Protocol):
    """Chooses layers for one client, slice after slice."""

    def choose_layers(self, situation: Situation) -> int:
        """How many layers, 1 to situation.num_layers, the next slice gets."""
        ...


@dataclass(frozen=True, slots=True)
class FixedPolicy:
    """The same number of layers whatever happens."""

    num_layers: int

    def choose_layers(self, situation: Situation) -> int:
        return min(self.num_layers, situation.num_layers)


@dataclass(frozen=True, slots=True)
class LayerPolicyConfig:
    """When a `LayerPolicy` climbs and drops; shares of the goal lead are 0 to 1."""

    safety: float = 0.9
    """Share of the estimated throughput that may be planned with."""
    low_lead: float = 0.25
    """Below this share of the goal lead only layer 0 is sent."""
    high_lead: float = 0.6
    """From this share of the goal lead on the policy may climb."""
    horizon_s: float = 2.0
    """A layer is dropped when keeping it would bring the lead under low_lead within this time."""
    climb_s: float = 0.5
    """Seconds of media between two climbs, of one layer each."""


@dataclass(slots=True)
class LayerPolicy:
    """Throughput decides what can be sustained, the lead decides when to move.

    Climbing asks that the link sustains the higher count by itself; staying asks only that the lead
    lasts for the horizon. The band between the two is what keeps it from flapping.
    """

    config: LayerPolicyConfig = field(default_factory=LayerPolicyConfig)
    _layers: int = field(init=False, default=1)
    _filled: bool = field(init=False, default=False)
    _slices_since_climb: int = field(init=False, default=0)

    def choose_layers(self, situation: Situation) -> int:
        self._layers = min(self._layers, situation.num_layers)
        self._slices_since_climb += 1
        self._layers = self._choose(situation)
        return self._layers

    def _choose(self, situation: Situation) -> int:
        config = self.config
        if situation.rate_bps is None:
            return 1
        rate_bps = config.safety * situation.rate_bps
        if situation.missing_slices:
            # The whole rest of the first window is due at once: it gets what fits the time left.
            scale = situation.missing_slices * situation.frame_s / max(situation.lead_s, 1e-3)
            return _most_layers(situation, rate_bps / scale)
        low_s = config.low_lead * situation.goal_lead_s
        comfortable = situation.lead_s >= config.high_lead * situation.goal_lead_s
        self._filled |= comfortable
        if situation.lead_s < low_s and self._filled:
            return 1
        if situation.lead_s < low_s:
            # Nothing went wrong, the lead was never there yet: let it grow as fast as it is played.
            return _most_layers(situation, rate_bps / 2)
        spare_s = situation.lead_s - low_s
        if situation.need_bps(self._layers) > situation.rate_bps * (1 + spare_s / config.horizon_s):
            return min(_most_layers(situation, rate_bps), max(1, self._layers - 1))
        if (
            self._layers < situation.num_layers
            and comfortable
            and self._slices_since_climb >= math.ceil(config.climb_s / situation.frame_s)
            and situation.need_bps(self._layers + 1) <= rate_bps
        ):
            self._slices_since_climb = 0
            return self._layers + 1
        return self._layers


def _most_layers(situation: Situation, rate_bps: float) -> int:
    """The most layers that `rate_bps` sustains, at least 1."""
    counts = range(situation.num_layers, 1, -1)
    return next((n for n in counts if situation.need_bps(n) <= rate_bps), 1)
