"""Mathematics of RobustMPC: its predictions, and that it finds the best plan."""

from __future__ import annotations

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from server.study.policies.robustmpc import RobustMpcConfig, RobustMpcRule, best_plan
from server.study.policies.situation import Situation
from server.study.simulate.qoe import QoeConfig
from tests.server.study.policies.situations import group, later, situation, situations

QOE = QoeConfig()


def worth(now: Situation, plan: list[int], rate_bps: float, last_db: float | None) -> float:
    """Value of a plan, computed group by group."""
    lead_s, held, total = now.lead_s, now.held, 0.0
    for layers, coming in zip(plan, now.coming, strict=True):
        takes_s = 8 * coming.cost_bytes(layers, held) / rate_bps
        stall_s, lead_s = max(0.0, takes_s - lead_s), max(0.0, lead_s - takes_s)
        lead_s = min(now.max_lead_s, lead_s + coming.media_s)
        quality_db = coming.psnr_db[layers - 1]
        step_db = 0.0 if last_db is None else abs(quality_db - last_db)
        total += quality_db * coming.media_s - QOE.stall_db * stall_s
        total -= QOE.switch_db * QOE.stretch_s * step_db
        held, last_db = layers, quality_db
    return total


def all_plans(now: Situation) -> list[list[int]]:
    plans: list[list[int]] = [[]]
    for coming in now.coming:
        plans = [
            [*plan, layers]
            for plan in plans
            for layers in range(1, coming.most_layers(plan[-1] if plan else now.held) + 1)
        ]
    return plans


@given(
    situations(horizon=4, most_layers=3),
    st.floats(1e5, 1e7),
    st.none() | st.floats(25, 33),
)
@settings(max_examples=60, deadline=None)
def test_no_plan_is_better_than_the_one_it_follows(
    now: Situation, rate_bps: float, last_db: float | None
) -> None:
    plans = all_plans(now)
    best = max(worth(now, plan, rate_bps, last_db) for plan in plans)
    layers = best_plan(now, rate_bps, last_db, QOE)
    followed = max(worth(now, p, rate_bps, last_db) for p in plans if p[0] == layers)
    assert followed == pytest.approx(best, abs=1e-6)


def test_it_pays_to_rise_where_the_layers_can_be_kept() -> None:
    # Three layers need 320 kbit/s, the rise to them 320 kbit.
    slots = group(snapshot_bytes=(50e3, 20e3, 20e3))
    stay = group(snapshot_bytes=(50e3, 20e3, 20e3), can_rise=False)
    assert best_plan(situation((slots, stay, stay, stay)), 400e3, 25.0, QOE) == 3
    assert best_plan(situation((slots, stay, stay, stay), lead_s=0.1), 400e3, 25.0, QOE) == 1
    assert best_plan(situation((stay, slots, stay, stay)), 400e3, 25.0, QOE) == 1


def predictions(rates_bps: list[float]) -> list[float]:
    rule, now = RobustMpcRule(RobustMpcConfig(past=3)), situation()
    return [rule._rate_bps(later(now, 0.5, rate_bps)) for rate_bps in rates_bps]


@given(st.lists(st.floats(1e4, 1e8), min_size=1, max_size=12))
def test_what_it_plans_with_is_below_the_greatest_rate_of_late(rates_bps: list[float]) -> None:
    for n, planned_bps in enumerate(predictions(rates_bps)):
        assert planned_bps <= max(rates_bps[max(0, n - 2) : n + 1]) * (1 + 1e-9)


def test_errors_of_late_make_it_careful() -> None:
    assert predictions([1e6, 1e6, 1e6]) == pytest.approx([1e6, 1e6, 1e6])
    # Half of the prediction arrived: an error of 1; the harmonic mean of 1, 1 and 0.5 is 0.75.
    planned = predictions([1e6, 1e6, 0.5e6])
    assert planned[-1] == pytest.approx(0.75e6 / 2)
    # The error is forgotten after three more.
    planned = predictions([1e6, 1e6, 0.5e6] + [0.5e6] * 6)
    assert planned[-1] == pytest.approx(0.5e6)
