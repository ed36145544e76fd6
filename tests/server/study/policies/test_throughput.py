"""Mathematics of the throughput rule."""

from __future__ import annotations

from dataclasses import replace

from hypothesis import given
from hypothesis import strategies as st

from server.study.policies.situation import Situation
from server.study.policies.throughput import ThroughputRule
from tests.server.study.policies.situations import group, situation, situations

rates = st.floats(1e4, 1e8)


@given(situations(), rates, rates)
def test_a_choice_never_falls_with_the_rate(now: Situation, one_bps: float, other: float) -> None:
    less_bps, more_bps = sorted((one_bps, other))
    rule = ThroughputRule()
    less = rule.choose_layers(replace(now, rate_bps=less_bps))
    assert less <= rule.choose_layers(replace(now, rate_bps=more_bps))


@given(situations())
def test_what_it_chooses_fits_and_one_more_would_not(now: Situation) -> None:
    rule = ThroughputRule()
    layers, safe_bps = rule.choose_layers(now), rule.safety * now.rate_bps
    assert 1 <= layers <= now.most_layers
    assert layers == 1 or now.need_bps(layers, rule.rise_s) <= safe_bps
    if layers < now.most_layers:
        assert now.need_bps(layers + 1, rule.rise_s) > safe_bps


def test_to_rise_is_paid_over_some_time() -> None:
    slots = group(snapshot_bytes=(50e3, 20e3, 20e3))
    rule = ThroughputRule(safety=1.0, rise_s=4.0)

    def chosen(rate_bps: float, held: int) -> int:
        return rule.choose_layers(situation((slots,), rate_bps, held=held))

    # 240 kbit/s for two layers, and 160 kbit within 4 s for the snapshot.
    assert chosen(279e3, held=1) == 1
    assert chosen(281e3, held=1) == 2
    assert chosen(241e3, held=2) == 2
