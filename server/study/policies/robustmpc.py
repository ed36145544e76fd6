"""RobustMPC: plans groups ahead against a rate that is promised to be low (Yin et al., 2015).

The rate is the harmonic mean of the last ones, over 1 + the greatest error that this very
prediction had made of late. Of all plans for the next groups the one is best that maximises the
sum of

    quality - stall_db * seconds of stall - switch_db * steps between groups

with the weights of qoe.py, and its first group is sent. The paper plans 5 chunks of 4 s for a
buffer of 30 s; this plans 5 groups of 1 s for a lead of 6 s.

All plans are a tree; two of them that end with the same layers differ only in the lead and the
worth so far, and one that has less of both is never better. So few are kept.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from statistics import harmonic_mean

from server.study.simulate.qoe import QoeConfig

from .rule import Rule, Situation

PAST = 5
"""Groups of which the rates and errors count (paper: 5)."""


@dataclass(frozen=True, slots=True)
class _Plan:
    """The groups of a plan so far."""

    first: int
    """Layers of its first group."""
    lead_s: float
    worth: float
    """dB times seconds."""


class RobustMpcRule(Rule):
    """Plans anew before each group."""

    horizon = 5
    group_s = 1.0  # as much of the lead is planned as in the paper

    def __init__(self) -> None:
        self._rates_bps: deque[float] = deque(maxlen=PAST)
        self._errors: deque[float] = deque(maxlen=PAST)
        self._predicted_bps: float | None = None
        self._lost_db: float | None = None

    def choose_layers(self, situation: Situation) -> int:
        layers = 1
        if situation.measured:
            rate_bps = self._rate_bps(situation)
            layers = best_plan(situation, rate_bps, self._lost_db, QoeConfig())
        self._lost_db = situation.group.lost_db(layers)
        return layers

    def _rate_bps(self, situation: Situation) -> float:
        """Takes in the rate of now, and says what to plan with."""
        rate_bps = situation.rate_bps
        if self._predicted_bps is not None:
            self._errors.append(abs(self._predicted_bps - rate_bps) / rate_bps)
        self._rates_bps.append(rate_bps)
        self._predicted_bps = harmonic_mean(self._rates_bps)
        return self._predicted_bps / (1 + max(self._errors, default=0.0))


def best_plan(situation: Situation, rate_bps: float, lost_db: float | None, qoe: QoeConfig) -> int:
    """The layers of the first group of the best plan; of equal ones the fewest.

    lost_db: what the group before lacks of all layers, dB; None at the beginning.
    """
    # Of each number of layers that a plan may end with, those plans that may still be best.
    plans: dict[int, list[_Plan]] = {situation.held: [_Plan(0, situation.lead_s, 0.0)]}
    for number, group in enumerate(situation.coming):
        before = situation.coming[number - 1] if number else None
        longer: dict[int, list[_Plan]] = {}
        for held, kept in plans.items():
            lost_before_db = before.lost_db(held) if before else lost_db
            for layers in range(1, group.most_layers(held) + 1):
                step_db = 0.0
                if lost_before_db is not None:
                    step_db = abs(group.lost_db(layers) - lost_before_db)
                worth = group.psnr_db[layers - 1] * group.media_s
                worth -= qoe.switch_db * qoe.stretch_s * step_db
                takes_s = 8 * group.cost_bytes(layers, held) / rate_bps
                longer.setdefault(layers, []).extend(
                    _Plan(
                        plan.first or layers,
                        min(situation.max_lead_s, max(0.0, plan.lead_s - takes_s) + group.media_s),
                        plan.worth + worth - qoe.stall_db * max(0.0, takes_s - plan.lead_s),
                    )
                    for plan in kept
                )
        plans = {layers: _undominated(found) for layers, found in longer.items()}
    found = [plan for kept in plans.values() for plan in kept]
    return max(found, key=lambda plan: (plan.worth, -plan.first)).first


def _undominated(plans: list[_Plan]) -> list[_Plan]:
    """The plans that no other plan surpasses in both lead and worth."""
    plans.sort(key=lambda plan: (-plan.worth, -plan.lead_s, plan.first))
    kept, longest_s = [], -1.0
    for plan in plans:
        if plan.lead_s > longest_s:
            kept.append(plan)
            longest_s = plan.lead_s
    return kept
