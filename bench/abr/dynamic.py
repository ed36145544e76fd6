"""Dynamic: the throughput rule while the lead is short, BOLA once it is long (dash.js).

BOLA needs a lead to speak of; the throughput rule does not. dash.js goes over to BOLA at 10 s or
more of a buffer, which is longer than ours may become: here it is half of the greatest lead.
"""

from __future__ import annotations

from server.study.policies import BolaRule, Rule, Situation, ThroughputRule

TO_BOLA = 0.5
"""Share of the greatest lead from which BOLA decides, if it does not choose fewer layers."""
TO_THROUGHPUT = 0.25
"""Share below which the throughput rule does again, if that chooses more (dash.js: half)."""


class Dynamic(Rule):
    """Asks both, and follows one."""

    def __init__(self) -> None:
        self.throughput: Rule = ThroughputRule()
        self.bola: Rule = BolaRule()
        self._by_bola = False

    def choose_layers(self, situation: Situation) -> int:
        carried = self.throughput.choose_layers(situation)
        layers = self.bola.choose_layers(situation)
        share = situation.lead_s / situation.max_lead_s
        if self._by_bola:
            self._by_bola = share >= TO_THROUGHPUT or layers >= carried
        else:
            self._by_bola = share >= TO_BOLA and layers >= carried
        return layers if self._by_bola else carried
