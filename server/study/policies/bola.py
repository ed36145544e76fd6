"""BOLA: the lead alone says how many layers, by a Lyapunov rule (Spiteri, Urgaonkar, Sitaraman).

Of each number of layers m the rule looks at what a byte of it is worth,

    (V * (v_m + g) - lead) / S_m

with S_m the bytes of the group, v_m its utility and g what it is worth to play on at all, and takes
the best. The less lead, the more counts that S_m is small. Utilities are dB over layer 0 of the
index, where the paper takes logarithms of bit rates. V and g follow from two leads: where more than
layer 0 begins, and up to which it pays to send all layers.

As the paper has it this creeps at the start and follows every lead upwards. BOLA-E mends both, and
so does this: until there is a lead the throughput rule decides, its choice is made good for by
seconds that are added to the lead, and are used up as the real one grows; it never climbs above
what the link carries; and no group may take longer to come than a share of the lead.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import accumulate

from .rule import Group, Rule, Situation
from .throughput import RISE_S, ThroughputRule

LOW_LEAD = 0.25
"""Share of the greatest lead up to which layer 0 is sent alone (paper: Q_low, 10 of 30 s)."""
HIGH_LEAD = 0.9
"""Share at which all layers are sent in any case (paper: Q_max, a chunk less than all)."""
ENOUGH_S = 1.0
"""Seconds of lead with which the start is over (BOLA-E: one chunk)."""
MOST_WAIT = 0.7
"""Share of the lead that a group may take to come (dash.js: insufficient buffer, 0.5 to 0.9)."""
TIE_S = 1e-3
"""Seconds of lead beyond where two numbers of layers are worth the same."""


@dataclass(frozen=True, slots=True)
class Lyapunov:
    """The two numbers of the rule, and what it chooses by them."""

    v_s_per_db: float
    """V: seconds of lead that a dB is worth."""
    g_db: float
    """g (the paper's gamma * p): what playing on is worth, dB."""
    sizes: tuple[float, ...]
    """S_m of 1, 2, ... layers, bytes."""
    utilities_db: tuple[float, ...]
    """v_m of 1, 2, ... layers; 0 for layer 0 alone."""

    @staticmethod
    def between(low_s: float, high_s: float, group: Group, held: int, rise: float) -> Lyapunov:
        """The rule that leaves layer 0 at a lead of low_s and wants nothing more at high_s.

        rise: share of what it takes to rise that is counted, as the group is not the only one that
        has the layers.
        """
        counted = (
            max(1.0, size) + rise * group.rise_bytes(n, held)
            for n, size in enumerate(group.slice_bytes, 1)
        )
        sizes = tuple(accumulate(counted, lambda before, size: max(size, before + 1.0)))
        utilities_db = tuple(psnr_db - group.psnr_db[0] for psnr_db in group.psnr_db)
        # m is better than 1 where the lead is over V * (g - S_1 * v_m / (S_m - S_1)).
        first_db = max(
            (
                sizes[0] * v / (size - sizes[0])
                for size, v in zip(sizes[1:], utilities_db[1:], strict=True)
            ),
            default=0.0,
        )
        v_s_per_db = (high_s - low_s) / max(utilities_db[-1] + first_db, 1e-9)
        return Lyapunov(v_s_per_db, low_s / v_s_per_db + first_db, sizes, utilities_db)

    def best(self, lead_s: float) -> int:
        """The number of layers that is worth most per byte; the fewer of two that are equal."""
        best, layers = -math.inf, 1
        for n, (size, utility_db) in enumerate(zip(self.sizes, self.utilities_db, strict=True), 1):
            worth = (self.v_s_per_db * (utility_db + self.g_db) - lead_s) / size
            if worth > best:
                best, layers = worth, n
        return layers

    def least_lead_s(self, num_layers: int) -> float:
        """The least lead at which it chooses `num_layers` or more."""
        sizes, values = self.sizes, [v + self.g_db for v in self.utilities_db]
        # Each fewer layers must have become worse than the best of those that are enough.
        leads = [
            min(
                self.v_s_per_db
                * (sizes[m] * values[n] - sizes[n] * values[m])
                / (sizes[m] - sizes[n])
                for m in range(num_layers - 1, len(sizes))
            )
            for n in range(num_layers - 1)
        ]
        return max(leads, default=0.0)


class BolaRule(Rule):
    """BOLA with what BOLA-E adds."""

    def __init__(self) -> None:
        self._throughput = ThroughputRule()
        self._starting = True
        self._added_s = 0.0
        """Seconds that are added to the lead (BOLA-E: the placeholder)."""

    def choose_layers(self, situation: Situation) -> int:
        group, lead_s, held = situation.group, situation.lead_s, situation.held
        carried = self._throughput.choose_layers(situation)
        low_s, high_s = LOW_LEAD * situation.max_lead_s, HIGH_LEAD * situation.max_lead_s
        rule = Lyapunov.between(low_s, high_s, group, held, group.media_s / RISE_S)
        if self._starting:
            self._starting = lead_s < ENOUGH_S
            self._added_s = max(0.0, rule.least_lead_s(carried) + TIE_S - lead_s)
            return carried
        self._added_s = min(self._added_s, max(0.0, situation.max_lead_s - lead_s))
        layers = rule.best(lead_s + self._added_s)
        if layers > max(carried, held):
            layers = max(carried, held)
            too_much_s = lead_s + self._added_s - rule.least_lead_s(layers) - TIE_S
            self._added_s = max(0.0, self._added_s - max(0.0, too_much_s))
        # At most as many layers as come while the lead lasts.
        layers = min(layers, situation.most_layers)
        most_bytes = MOST_WAIT * lead_s * situation.rate_bps / 8
        while layers > 1 and group.cost_bytes(layers, held) > most_bytes:
            layers -= 1
        return layers
