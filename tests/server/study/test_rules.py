"""Mathematics of the rules that choose a number of layers."""

from __future__ import annotations

from dataclasses import replace
from itertools import accumulate

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from server.study.policies import (
    PAST,
    RISE_S,
    SAFETY,
    BolaRule,
    Group,
    Lyapunov,
    RobustMpcRule,
    Rule,
    Situation,
    TailDropRule,
    ThroughputRule,
    best_plan,
)
from server.study.qoe import QoeConfig

MAX_LEAD_S = 6.0


def group(
    layer_bytes: tuple[float, ...] = (10e3, 5e3, 5e3),
    gains_db: tuple[float, ...] = (25.0, 2.0, 1.0),
    keyframe_bytes: tuple[float, ...] = (),
    can_rise: bool = True,
    media_s: float = 0.5,
) -> Group:
    return Group(
        media_s,
        tuple(accumulate(layer_bytes)),
        tuple(accumulate(gains_db)),
        tuple(accumulate(keyframe_bytes)) or (0.0,) * len(layer_bytes),
        can_rise,
    )


def situation(
    coming: tuple[Group, ...] = (group(),),
    rate_bps: float = 1e6,
    lead_s: float = 3.0,
    held: int = 1,
    now_s: float = 0.0,
    measured: bool = True,
) -> Situation:
    return Situation(now_s, rate_bps, measured, lead_s, MAX_LEAD_S, held, coming)


def later(before: Situation, passed_s: float, rate_bps: float) -> Situation:
    return replace(before, now_s=before.now_s + passed_s, rate_bps=rate_bps)


@st.composite
def groups(draw: st.DrawFn, num_layers: int) -> Group:
    sizes = tuple(draw(st.floats(1e3, 1e5)) for _ in range(num_layers))
    gains = (25.0, *(draw(st.floats(0.0, 4.0)) for _ in range(num_layers - 1)))
    keyframes = tuple(draw(st.floats(1e3, 3e5)) for _ in range(num_layers))
    return group(sizes, gains, keyframes, draw(st.booleans()))


@st.composite
def situations(draw: st.DrawFn, horizon: int = 1, most_layers: int = 5) -> Situation:
    """Any situation of a client that plays."""
    layers = draw(st.integers(1, most_layers))
    return situation(
        tuple(draw(groups(layers)) for _ in range(draw(st.integers(1, horizon)))),
        draw(st.floats(1e5, 1e8)),
        draw(st.floats(0, MAX_LEAD_S)),
        draw(st.integers(1, layers)),
    )


@given(situations())
def test_what_it_chooses_fits_and_one_more_would_not(now: Situation) -> None:
    layers, safe_bps = ThroughputRule().choose_layers(now), SAFETY * now.rate_bps
    assert 1 <= layers <= now.most_layers
    assert layers == 1 or now.need_bps(layers, RISE_S) <= safe_bps
    if layers < now.most_layers:
        assert now.need_bps(layers + 1, RISE_S) > safe_bps


def test_to_rise_is_paid_over_some_time() -> None:
    slots = group(keyframe_bytes=(50e3, 20e3, 20e3))

    def chosen(safe_bps: float, held: int) -> int:
        return ThroughputRule().choose_layers(situation((slots,), safe_bps / SAFETY, held=held))

    # 240 kbit/s for two layers, and 160 kbit within 4 s for the keyframe.
    assert chosen(279e3, held=1) == 1
    assert chosen(281e3, held=1) == 2
    assert chosen(241e3, held=2) == 2


def test_between_two_layers_there_are_no_turns() -> None:
    keyframes = (50e3, 20e3, 20e3)
    slots = group(keyframe_bytes=keyframes, media_s=1 / 30)
    middle = group(can_rise=False, media_s=1 / 30)
    rule = TailDropRule()
    for safe_bps, layers in ((2.3e6, 1), (3.5e6, 1), (3.7e6, 2), (4.9e6, 3)):
        for coming in (slots, middle):
            now = situation((coming,), safe_bps / SAFETY, held=3)
            assert {rule.choose_layers(now) for _ in range(50)} == {layers}


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
    carried = ThroughputRule().choose_layers(first)
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


QOE = QoeConfig()


def worth(now: Situation, plan: list[int], rate_bps: float, lost_db: float | None) -> float:
    """Value of a plan, computed group by group."""
    lead_s, held, total = now.lead_s, now.held, 0.0
    for layers, coming in zip(plan, now.coming, strict=True):
        takes_s = 8 * coming.cost_bytes(layers, held) / rate_bps
        stall_s, lead_s = max(0.0, takes_s - lead_s), max(0.0, lead_s - takes_s)
        lead_s = min(now.max_lead_s, lead_s + coming.media_s)
        quality_db, last_lost_db = coming.psnr_db[layers - 1], lost_db
        held, lost_db = layers, coming.psnr_db[-1] - quality_db
        step_db = 0.0 if last_lost_db is None else abs(lost_db - last_lost_db)
        total += quality_db * coming.media_s - QOE.stall_db * stall_s
        total -= QOE.switch_db * QOE.stretch_s * step_db
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


@given(situations(horizon=4, most_layers=3), st.floats(1e5, 1e7), st.none() | st.floats(0, 8))
@settings(max_examples=60, deadline=None)
def test_no_plan_is_better_than_the_one_it_follows(
    now: Situation, rate_bps: float, lost_db: float | None
) -> None:
    plans = all_plans(now)
    best = max(worth(now, plan, rate_bps, lost_db) for plan in plans)
    layers = best_plan(now, rate_bps, lost_db, QOE)
    followed = max(worth(now, p, rate_bps, lost_db) for p in plans if p[0] == layers)
    assert followed == pytest.approx(best, abs=1e-6)


def predictions(rates_bps: list[float]) -> list[float]:
    rule, now = RobustMpcRule(), situation()
    return [rule._rate_bps(later(now, 0.5, rate_bps)) for rate_bps in rates_bps]


@given(st.lists(st.floats(1e4, 1e8), min_size=1, max_size=12))
def test_what_it_plans_with_is_below_the_greatest_rate_of_late(rates_bps: list[float]) -> None:
    for n, planned_bps in enumerate(predictions(rates_bps)):
        assert planned_bps <= max(rates_bps[max(0, n + 1 - PAST) : n + 1]) * (1 + 1e-9)


def test_errors_of_late_make_it_careful() -> None:
    assert predictions([1e6, 1e6, 1e6]) == pytest.approx([1e6, 1e6, 1e6])
    # Half of the prediction arrived: an error of 1; the harmonic mean of 1, 1 and 0.5 is 0.75.
    planned = predictions([1e6, 1e6, 0.5e6])
    assert planned[-1] == pytest.approx(0.75e6 / 2)
    # The error is forgotten after PAST more.
    planned = predictions([1e6, 1e6, 0.5e6] + [0.5e6] * 2 * PAST)
    assert planned[-1] == pytest.approx(0.5e6)


@pytest.mark.parametrize("rule", [RobustMpcRule(), TailDropRule(), ThroughputRule()])
def test_before_anything_is_measured_there_is_one_layer(rule: Rule) -> None:
    assert rule.choose_layers(situation(rate_bps=1e9, measured=False)) == 1
