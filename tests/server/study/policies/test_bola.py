"""Mathematics of BOLA."""

from __future__ import annotations

from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from server.study.policies.bola import BolaConfig, BolaRule, Lyapunov
from server.study.policies.situation import Situation
from tests.server.study.policies.situations import MAX_LEAD_S, group, groups, situation, situations

leads = st.floats(0, 2 * MAX_LEAD_S)


@st.composite
def rules(draw: st.DrawFn) -> Lyapunov:
    low_s = draw(st.floats(0, 3))
    return Lyapunov.between(low_s, 6.0, draw(groups(draw(st.integers(1, 6)))), held=1, rise=0.1)


@given(rules(), leads, leads)
def test_more_lead_never_means_fewer_layers(rule: Lyapunov, one_s: float, other_s: float) -> None:
    less_s, more_s = sorted((one_s, other_s))
    assert rule.best(less_s) <= rule.best(more_s + 1e-9)


@given(rules(), st.integers(1, 6))
def test_the_least_lead_is_where_it_begins_to_choose_so_many(rule: Lyapunov, layers: int) -> None:
    layers = min(layers, len(rule.sizes))
    lead_s = rule.least_lead_s(layers)
    assert rule.best(lead_s + 1e-6) >= layers
    if layers > 1:
        assert rule.best(lead_s - 1e-6) < layers


@given(st.floats(0, 3))
def test_it_leaves_layer_0_at_the_low_lead_and_wants_nothing_more_at_the_high_one(
    low_s: float,
) -> None:
    coming = group((10e3, 4e3, 6e3), (25.0, 3.0, 1.0))
    rule = Lyapunov.between(low_s, 6.0, coming, held=3, rise=0.0)
    assert rule.least_lead_s(2) == pytest.approx(low_s, abs=1e-9)
    top = rule.v_s_per_db * (rule.utilities_db[-1] + rule.g_db)
    assert top == pytest.approx(6.0)


def started(rate_bps: float, lead_s: float) -> BolaRule:
    """A rule that started on a link for layer 0, so that its lead is the real one."""
    rule = BolaRule()
    rule.choose_layers(situation(rate_bps=100e3, lead_s=1.0))
    rule.choose_layers(situation(rate_bps=rate_bps, lead_s=lead_s))
    return rule


def test_the_lead_decides_below_what_the_link_carries() -> None:
    # Three layers need 320 kbit/s.
    leads_s = (0.5, 1.0, 1.6, 3.0, 4.5, 5.5, 6.0)
    chosen = [started(1e6, s).choose_layers(situation(lead_s=s)) for s in leads_s]
    assert chosen == sorted(chosen)
    assert (chosen[0], chosen[1], chosen[2], chosen[-2]) == (1, 1, 2, 3)


def test_a_long_lead_does_not_lift_it_above_the_link() -> None:
    rule = started(200e3, 5.9)
    assert rule.choose_layers(situation(rate_bps=200e3, lead_s=5.9)) == 1


@given(situations(), st.floats(1e4, 1e8))
def test_it_starts_as_the_throughput_rule_would(now: Situation, rate_bps: float) -> None:
    rule = BolaRule()
    first = replace(now, lead_s=0.0, rate_bps=rate_bps)
    carried = BolaConfig().throughput.choose_layers(first)
    assert rule.choose_layers(first) == carried


def test_what_was_added_to_the_lead_keeps_the_layers() -> None:
    rule = BolaRule()
    for lead_s in (0.0, 0.5, 1.1, 1.5, 2.0, 3.0, 5.0, 6.0):
        assert rule.choose_layers(situation(rate_bps=1e6, lead_s=lead_s)) == 3


def test_a_group_may_not_eat_up_the_lead() -> None:
    rule = started(1e6, 5.9)
    collapsed = situation(rate_bps=20e3, lead_s=5.0)
    # 160 kbit take 8 s; 80 kbit take 4 s, but 0.7 * 5 s is less: only layer 0 remains.
    assert rule.choose_layers(collapsed) == 1
