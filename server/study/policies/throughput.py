"""The rules that go by the rate of this moment alone."""

from __future__ import annotations

from .rule import Rule, Situation

SAFETY = 0.9
"""Share of the estimated rate that is planned with (dash.js, Sabre)."""
RISE_S = 4.0
"""Seconds over which the snapshots that a rise takes are spread (ours)."""


class ThroughputRule(Rule):
    """The most layers that the link carries, with something kept back.

    Where dash.js takes the less of two moving averages with half lives of 3 s and 8 s, this goes by
    the estimate as it is. The session's looks back 0.4 s already, decisions are ten times as
    frequent, and with a lead of 6 s every second of delay in reacting costs more than a wrong step.
    """

    def choose_layers(self, situation: Situation) -> int:
        if not situation.measured:
            return 1
        rate_bps = SAFETY * situation.rate_bps
        counts = range(situation.most_layers, 1, -1)
        return next((n for n in counts if situation.need_bps(n, RISE_S) <= rate_bps), 1)


class TailDropRule(Rule):
    """The paper SwinGS's own (section 5.5), slice by slice: the least opaque Gaussians are dropped
    to fit the rate.

    All layers are sent as long as the link carries them; else the tail of each slice is left out. A
    layer is all or nothing, and after it is left out once it is gone until the next segment. The
    paper's demonstration knows the rate and fits all of it; here it is what was measured, and
    SAFETY of it, or there would never be a lead.
    """

    group_s = 0.0

    def choose_layers(self, situation: Situation) -> int:
        if not situation.measured:
            return 1
        group = situation.group
        budget_bytes = SAFETY * situation.rate_bps * group.media_s / 8
        counts = range(situation.most_layers, 1, -1)
        return next((n for n in counts if group.slice_bytes[n - 1] <= budget_bytes), 1)
