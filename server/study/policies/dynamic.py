"""Dynamic: the throughput rule while the lead is short, BOLA once it is long (dash.js).

BOLA needs a lead to speak of; the throughput rule does not. dash.js goes over to BOLA at 10 s or
more of a buffer, which is longer than ours may become: here it is half of the greatest lead.
"""

from __future__ import annotations

from dataclasses import dataclass, field

from codec.errors import InvalidError

from .bola import BolaConfig, BolaRule
from .situation import Rule, Situation


@dataclass(frozen=True, slots=True)
class DynamicConfig:
    """When a `DynamicRule` goes over."""

    to_bola: float = 0.5
    """Share of the greatest lead from which BOLA decides, if it does not choose fewer layers."""
    to_throughput: float = 0.25
    """Share below which the throughput rule does again, if that chooses more (dash.js: half)."""
    bola: BolaConfig = field(default_factory=BolaConfig)
    """Both rules; BOLA knows the other one."""

    def __post_init__(self) -> None:
        if not 0 <= self.to_throughput <= self.to_bola <= 1:
            raise InvalidError(
                f"to_throughput is {self.to_throughput} and to_bola {self.to_bola}; "
                "give them rising in 0..1"
            )


class DynamicRule:
    """Asks both, and follows one."""

    horizon = 1

    def __init__(self, config: DynamicConfig | None = None) -> None:
        self._config = config or DynamicConfig()
        self._throughput: Rule = self._config.bola.throughput
        self._bola: Rule = BolaRule(self._config.bola)
        self._by_bola = False

    def choose_layers(self, situation: Situation) -> int:
        carried = self._throughput.choose_layers(situation)
        layers = self._bola.choose_layers(situation)
        share = situation.lead_s / situation.max_lead_s
        if self._by_bola:
            self._by_bola = share >= self._config.to_throughput or layers >= carried
        else:
            self._by_bola = share >= self._config.to_bola and layers >= carried
        return layers if self._by_bola else carried
