"""The overload ladder and its meter in virtual time."""

from __future__ import annotations

import asyncio

import pytest
from hypothesis import given
from hypothesis import strategies as st

from server.operate.overload import MAX_LOAD, LoadSample, Overload, OverloadConfig, measure_load
from tests.support.server.virtualtime import hold_up, in_virtual_time, passes

CONFIG = OverloadConfig()
STEP_S = 0.25


def run(
    overload: Overload, begin_s: float, seconds: float, busy: float = 0.0, **more: float
) -> float:
    """Feeds `seconds` of samples of one load; returns the time of their end."""
    now_s = begin_s
    while now_s < begin_s + seconds:
        now_s += STEP_S
        overload.observe(LoadSample(now_s, busy, **more))
    return now_s


def settled(busy: float) -> Overload:
    overload = Overload(CONFIG, max_plays=10)
    run(overload, 0.0, 60.0, busy)
    return overload


def test_all_layers_below_the_first_step_and_one_at_the_last() -> None:
    assert settled(0.0).max_layers(5) == 5
    assert settled(0.79).max_layers(5) == 5
    steps = [settled(busy).max_layers(5) for busy in (0.82, 0.85, 0.88, 0.91, 0.94)]
    assert steps == [5, 4, 3, 2, 1]
    assert settled(0.94).accepts_plays(0)
    assert settled(0.96).max_layers(5) == 1
    assert not settled(0.96).accepts_plays(0)
    assert settled(1.0).max_layers(1) == 1


def test_who_comes_back_is_let_in_where_a_new_play_is_not() -> None:
    overload = settled(0.99)
    assert not overload.accepts_plays(0)
    assert overload.accepts_plays(0, continues=True)
    assert not Overload(OverloadConfig(), max_plays=3).accepts_plays(3, continues=True)


def test_layers_go_before_plays_are_refused() -> None:
    overload = Overload(CONFIG, max_plays=10)
    now_s, seen = 0.0, []
    while overload.accepts_plays(0):
        now_s = run(overload, now_s, STEP_S, 1.0)
        seen.append(overload.max_layers(5))
    assert sorted(seen, reverse=True) == seen
    assert set(seen) >= {5, 1}
    assert now_s < 5  # and it does not take long


@pytest.mark.parametrize("load", [{"busy": 1.0}, {"late_s": 0.2}, {"egress_bps": 1e9}])
def test_each_of_what_is_measured_is_load(load: dict[str, float]) -> None:
    overload = Overload(OverloadConfig(max_egress_bps=1e9), max_plays=10)
    run(overload, 0.0, 25.0, **load)
    assert not overload.accepts_plays(0)


def test_egress_counts_only_where_it_is_limited() -> None:
    overload = Overload(CONFIG, max_plays=10)
    run(overload, 0.0, 25.0, egress_bps=1e12)
    assert overload.load == 0


def test_the_last_place_is_taken_whole_and_no_more() -> None:
    overload = Overload(CONFIG, max_plays=2)
    assert [overload.accepts_plays(n) for n in range(4)] == [True, True, False, False]
    assert overload.max_layers(5) == 5
    assert overload.retry_after_s == 2


def test_one_bad_sample_does_not_refuse_anybody() -> None:
    overload = settled(0.3)
    overload.observe(LoadSample(1000.0, busy_share=9.0, late_s=940.0))
    assert overload.accepts_plays(0)


def test_load_around_a_step_does_not_flap() -> None:
    """Layers that were shed because of 0.86 do not come back at 0.82, to be shed again."""
    assert settled(0.86).max_layers(5) < settled(0.82).max_layers(5)
    overload = settled(0.86)
    now_s, before = 60.0, overload.max_layers(5)
    for _ in range(50):
        for busy in (0.82, 0.86):
            now_s = run(overload, now_s, 5.0, busy)
            assert overload.max_layers(5) == before


def test_it_recovers_and_says_when_to_come_back() -> None:
    overload = settled(1.2)
    wait_s = overload.retry_after_s
    assert 2 <= wait_s <= 10
    now_s = run(overload, 60.0, wait_s, 0.3)
    assert overload.accepts_plays(0)
    run(overload, now_s, 6.0, 0.3)
    assert overload.max_layers(5) == 5


loads = st.floats(0, 3)
steps = st.lists(st.tuples(st.floats(0, 2), loads, loads), max_size=60)


@given(steps)
def test_more_load_never_gives_more(samples: list[tuple[float, float, float]]) -> None:
    low, high, now_s = Overload(CONFIG, 10), Overload(CONFIG, 10), 0.0
    for seconds, one, other in samples:
        now_s += seconds
        low.observe(LoadSample(now_s, min(one, other)))
        high.observe(LoadSample(now_s, max(one, other)))
        assert 0 <= low.load <= high.load + 1e-12 <= MAX_LOAD + 1e-9
        assert low.max_layers(6) >= high.max_layers(6) >= 1
        assert low.accepts_plays(3) or not high.accepts_plays(3)


@given(steps)
def test_whatever_happened_calm_brings_all_back(samples: list[tuple[float, float, float]]) -> None:
    overload, now_s = Overload(CONFIG, 10), 0.0
    for seconds, busy, _ in samples:
        now_s += seconds
        overload.observe(LoadSample(now_s, busy))
    run(overload, now_s, MAX_LOAD / CONFIG.recover_per_s, 0.7)
    assert overload.max_layers(6) == 6
    assert overload.accepts_plays(3)


@in_virtual_time
async def test_the_meter_sees_a_loop_that_is_held_up(monkeypatch: pytest.MonkeyPatch) -> None:
    samples: list[LoadSample] = []
    cpu_s = sent = 0.0
    monkeypatch.setattr("server.operate.overload.time.process_time", lambda: cpu_s)
    meter = asyncio.create_task(measure_load(samples.append, lambda: int(sent), 0.05))
    await passes(0.12)
    cpu_s, sent = 0.4, 125_000
    hold_up(0.5)
    await passes(0.12)
    meter.cancel()
    worst = max(samples, key=lambda sample: sample.late_s)
    assert worst.late_s == pytest.approx(0.47)
    assert worst.busy_share == pytest.approx(0.4 / 0.52)
    assert worst.egress_bps == pytest.approx(1e6 / 0.52)
    assert sum(sample.egress_bps > 0 for sample in samples) == 1
    assert len(samples) == 5
