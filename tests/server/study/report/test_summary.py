"""Summaries of many plays: means, intervals, normalised QoE and paired differences, by hand."""

from __future__ import annotations

import math
from statistics import fmean

import pytest
from scipy.stats import binom

from codec.errors import InvalidError
from server.study.plays import Oracle, Outcome, Play
from server.study.report.bootstrap import mean_interval
from server.study.report.summary import normalised_mean, summarise
from server.study.report.tables import HEAD, rows


@pytest.mark.parametrize(("ones", "zeros"), [(5, 5), (3, 17), (30, 10)])
def test_the_mean_of_coins_is_binomial(ones: int, zeros: int) -> None:
    count = ones + zeros
    interval = mean_interval([1.0] * ones + [0.0] * zeros, seed=1)
    assert interval.mean == ones / count
    # With 10,000 draws the share below a point is accurate to about a percent; the points are
    # 1 / count apart.
    low, high = binom.ppf([0.015, 0.035], count, ones / count) / count
    assert low <= interval.low <= high
    low, high = binom.ppf([0.965, 0.985], count, ones / count) / count
    assert low <= interval.high <= high


@pytest.mark.parametrize(
    ("values", "resamples", "level"), [([], 10, 0.95), ([1.0], 0, 0.95), ([1.0], 10, 1.0)]
)
def test_nothing_to_draw_from_is_refused(values: list[float], resamples: int, level: float) -> None:
    with pytest.raises(InvalidError, match="bootstrap"):
        mean_interval(values, 0, resamples, level)


def play(policy: str, quality_db: float, came_bytes: float = 100.0, wasted: float = 0.0) -> Play:
    return Play(
        policy=policy,
        quality_db=quality_db,
        normalised=quality_db / 100,
        psnr_db=30.0,
        low_psnr_db=29.0,
        rebuffering=0.01,
        startup_s=0.2,
        stalls=1,
        step_db=0.1,
        layers=2.0,
        came_bytes=came_bytes,
        wasted=wasted,
    )


def outcome(trace: str, load: float, base_db: float, bound_db: float, *plays: Play) -> Outcome:
    return Outcome(trace, load, Oracle(bound_db, 31.0, base_db, 0.005, 0.1), plays)


OUTCOMES = [
    outcome("a", 1.0, 20, 30, play("bola", 24), play("sweep", 26)),
    outcome("b", 1.0, 10, 30, play("bola", 20), play("sweep", 21)),
    outcome("a", 2.0, 25, 31, play("bola", 28), play("sweep", 28)),
    outcome("b", 2.0, 25, 31, play("bola", 29), play("sweep", 30)),
]


def test_normalised_qoe_is_a_ratio_of_means() -> None:
    plays = [one.plays[1] for one in OUTCOMES[:2]]
    oracles = [one.oracle for one in OUTCOMES[:2]]
    assert normalised_mean(plays, oracles) == pytest.approx((23.5 - 15) / (30 - 15))


def test_where_there_is_nothing_to_gain_it_says_nothing() -> None:
    same = outcome("a", 1.0, 25, 25, play("sweep", 25))
    assert math.isnan(normalised_mean(same.plays, [same.oracle]))
    # In the table that is an empty cell, and neither 0 nor 1.
    (row, _) = rows(summarise([same], 0))
    assert row[HEAD.index("normalised")] == ""


def test_differences_are_paired_and_a_trace_counts_once() -> None:
    by_load = summarise(OUTCOMES, seed=3)
    assert [one.load for one in by_load] == [1.0, 2.0, None]
    behind = [one.standings[0].behind for one in by_load]
    assert behind == [
        mean_interval([2.0, 1.0], 3),
        mean_interval([0.0, 1.0], 3),
        mean_interval([fmean([2, 0]), fmean([1, 1])], 3),
    ]
    assert all(one.standings[1].behind is None for one in by_load)


def test_waste_is_a_share_of_all_bytes() -> None:
    plays = [play("sweep", 25, 900, 0.0), play("sweep", 25, 100, 0.5)]
    outcomes = [outcome(name, 1.0, 20, 30, one) for name, one in zip("ab", plays, strict=True)]
    assert summarise(outcomes, 0)[0].standings[0].wasted == pytest.approx(0.05)
