"""Estimator and policies as mathematics."""

from __future__ import annotations

import copy
import itertools
import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from server.abr.estimator import EstimatorConfig, ThroughputEstimator
from server.abr.policy import FixedPolicy, LayerPolicy, LayerPolicyConfig, Situation

WHOLE = EstimatorConfig().min_sample_bytes

samples = st.lists(
    st.tuples(
        st.floats(0, 10),  # seconds since the sample before
        st.integers(WHOLE, 10_000_000),
        st.floats(1e-4, 10),
    ),
    min_size=1,
    max_size=20,
)
rates_bps = st.floats(1e3, 1e10)


def fed(steps: list[tuple[float, int, float]]) -> ThroughputEstimator:
    estimator, now_s = ThroughputEstimator(), 0.0
    for pause_s, num_bytes, busy_s in steps:
        now_s += pause_s
        estimator.add(now_s, num_bytes, busy_s)
    return estimator


@given(samples)
def test_estimate_lies_between_the_slowest_and_the_fastest_sample(
    steps: list[tuple[float, int, float]],
) -> None:
    rates = [8 * num_bytes / busy_s for _, num_bytes, busy_s in steps]
    rate_bps = fed(steps).rate_bps
    assert rate_bps is not None
    assert min(rates) * (1 - 1e-9) <= rate_bps <= max(rates) * (1 + 1e-9)


@given(samples, st.integers(0, 19), st.integers(1, 1_000_000))
def test_estimate_rises_with_the_bytes_of_any_sample(
    steps: list[tuple[float, int, float]], which: int, more_bytes: int
) -> None:
    which %= len(steps)
    pause_s, num_bytes, busy_s = steps[which]
    better = [*steps[:which], (pause_s, num_bytes + more_bytes, busy_s), *steps[which + 1 :]]
    before, after = fed(steps).rate_bps, fed(better).rate_bps
    assert before is not None
    assert after is not None
    assert after >= before * (1 - 1e-9)


@given(st.lists(st.integers(1, WHOLE // 4), min_size=1, max_size=60))
def test_tiny_samples_are_gathered_not_averaged(sizes: list[int]) -> None:
    # Time passes alike for all, so only the sums can tell the rate.
    estimator = ThroughputEstimator()
    for size in sizes:
        estimator.add(0.0, size, size / 1000)
    if sum(sizes) < WHOLE:
        assert estimator.rate_bps is None
    else:
        assert estimator.rate_bps == pytest.approx(8000)


def test_a_lower_bound_counts_only_where_it_raises() -> None:
    estimator = ThroughputEstimator()
    estimator.add(0.0, 100_000, 1.0)
    estimator.add(1.0, 50_000, 1.0, at_least=True)
    assert estimator.rate_bps == pytest.approx(800_000)
    estimator.add(2.0, 900_000, 1.0, at_least=True)
    assert estimator.rate_bps is not None
    assert estimator.rate_bps > 800_000


def test_a_drop_is_believed_before_a_rise() -> None:
    def after_change(from_bps: float, to_bps: float) -> float:
        estimator = ThroughputEstimator()
        for step in range(200):
            rate_bps = from_bps if step < 100 else to_bps
            estimator.add(step * 0.02, int(rate_bps * 0.02 / 8), 0.02)
        assert estimator.rate_bps is not None
        return (estimator.rate_bps - to_bps) / (from_bps - to_bps)

    down, up = after_change(50e6, 20e6), after_change(20e6, 50e6)
    assert 0 < down < 0.3  # two short half-lives
    assert down < up < 0.8


def test_after_a_pause_a_short_new_sample_rules() -> None:
    estimator = ThroughputEstimator()
    for step in range(100):
        estimator.add(step * 0.1, 75_000, 0.1)  # 6 Mbit/s, busy all the time
    # Then a link so fast that each burst keeps it busy for 24 ms only.
    for step in range(1, 13):
        estimator.add(10 + step * 0.5, 300_000, 0.024)
    assert estimator.rate_bps is not None
    assert estimator.rate_bps > 12e6


situations = st.builds(
    lambda rate_bps, steps, frame_s, goal_s, lead, missing: Situation(
        rate_bps=rate_bps,
        slice_bytes=tuple(math.fsum(steps[: n + 1]) for n in range(len(steps))),
        frame_s=frame_s,
        lead_s=lead * goal_s,
        goal_lead_s=goal_s,
        missing_slices=missing,
    ),
    st.none() | rates_bps,
    st.lists(st.floats(1, 1e6), min_size=1, max_size=16),
    st.floats(0.005, 0.1),
    st.floats(0.1, 5),
    st.floats(0, 1),
    st.just(0) | st.integers(0, 300),
)


def at_rate(situation: Situation, rate_bps: float) -> Situation:
    return Situation(
        rate_bps,
        situation.slice_bytes,
        situation.frame_s,
        situation.lead_s,
        situation.goal_lead_s,
        situation.missing_slices,
    )


@given(st.lists(situations, min_size=1, max_size=30))
def test_a_policy_never_leaves_the_layers_there_are(history: list[Situation]) -> None:
    policy = LayerPolicy()
    for situation in history:
        assert 1 <= policy.choose_layers(situation) <= situation.num_layers
        assert FixedPolicy(7).choose_layers(situation) == min(7, situation.num_layers)


@given(st.lists(situations, max_size=20), situations, rates_bps, rates_bps)
def test_a_choice_is_monotone_in_the_rate(
    history: list[Situation], last: Situation, one_bps: float, other_bps: float
) -> None:
    policy = LayerPolicy()
    for situation in history:
        policy.choose_layers(situation)
    low, high = (
        copy.deepcopy(policy).choose_layers(at_rate(last, rate_bps))
        for rate_bps in sorted((one_bps, other_bps))
    )
    assert low <= high


def playing(rate_bps: float | None, lead_s: float) -> Situation:
    # 30 fps, one layer more costs 1 Mbit/s more.
    step = 1e6 / 30 / 8
    return Situation(rate_bps, (step, 2 * step, 3 * step, 4 * step), 1 / 30, lead_s, 2.0)


def settled(rate_bps: float) -> LayerPolicy:
    policy = LayerPolicy()
    for _ in range(300):
        policy.choose_layers(playing(rate_bps, 2.0))
    return policy


def test_an_unknown_rate_gets_the_base_layer() -> None:
    assert LayerPolicy().choose_layers(playing(None, 2.0)) == 1


@pytest.mark.parametrize(("rate_bps", "layers"), [(0.3e6, 1), (2.3e6, 2), (3.4e6, 3), (9e6, 4)])
def test_it_climbs_to_what_the_link_sustains_and_stays(rate_bps: float, layers: int) -> None:
    policy = settled(rate_bps)
    assert {policy.choose_layers(playing(rate_bps, 1.9)) for _ in range(100)} == {layers}


def test_it_climbs_one_layer_in_half_a_second_of_media() -> None:
    policy = LayerPolicy()
    policy.choose_layers(playing(1.2e6, 2.0))
    chosen = [policy.choose_layers(playing(9e6, 2.0)) for _ in range(60)]
    assert chosen[-1] == 4
    assert [chosen.index(n) for n in (2, 3, 4)] == [13, 28, 43]


def test_a_low_lead_drops_to_the_base_layer_at_once() -> None:
    policy = settled(9e6)
    assert policy.choose_layers(playing(9e6, 0.49)) == 1
    assert policy.choose_layers(playing(9e6, 1.0)) == 1  # the lead must be comfortable first
    for _ in range(15):
        layers = policy.choose_layers(playing(9e6, 1.3))
    assert layers == 2


def test_a_lead_that_was_never_there_is_not_a_reason_to_drop() -> None:
    policy = LayerPolicy()
    # Half of 9 Mbit/s sustains all layers, so they go out while the lead grows, with its ups and
    # downs.
    for lead_s in (0.0, 0.3, 0.6, 0.4, 0.7):
        assert policy.choose_layers(playing(9e6, lead_s)) == 4
    assert LayerPolicy().choose_layers(playing(4e6, 0.0)) == 1


def test_a_lead_carries_over_a_dip_but_not_over_a_collapse() -> None:
    # 4 layers need 4 Mbit/s: 1.5 s of spare lead last for 2 s down to 2.3 Mbit/s.
    assert settled(9e6).choose_layers(playing(2.4e6, 2.0)) == 4
    assert settled(9e6).choose_layers(playing(2.2e6, 2.0)) == 1
    assert settled(9e6).choose_layers(playing(3.4e6, 0.6)) == 3


def test_estimates_that_waver_do_not_make_it_flap() -> None:
    policy = settled(9e6)
    chosen = []
    for step in range(300):
        rate_bps = 3.6e6 * (1 + 0.2 * math.sin(step / 5))
        chosen.append(policy.choose_layers(playing(rate_bps, 1.6)))
    changes = sum(a != b for a, b in itertools.pairwise(chosen))
    assert changes <= 1


def test_the_first_window_gets_what_fits_its_time() -> None:
    step = 10_000.0

    def missing(count: int, rate_bps: float) -> int:
        situation = Situation(
            rate_bps, (step, 2 * step, 3 * step, 4 * step), 1 / 30, 0.5, 2.0, missing_slices=count
        )
        return LayerPolicy(LayerPolicyConfig(safety=1.0)).choose_layers(situation)

    # 10 slices of n * 10 KB in half a second: n * 1.6 Mbit/s.
    assert [missing(10, rate) for rate in (1.7e6, 3.1e6, 3.3e6, 4.9e6, 6.5e6)] == [1, 1, 2, 3, 4]
    assert missing(1, 1.7e6) == 4
