"""Generated links have the requested properties."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise
from statistics import fmean, pstdev
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from codec.errors import InvalidError
from server.abr.link import Link
from server.study import generate as generator
from server.study.generate import GeneratorConfig, chain_rates_bps, generate
from tests.support.hostile import refused

configs = st.builds(
    GeneratorConfig,
    variation=st.floats(1e-3, generator.MAX_VARIATION),
    dwell_s=st.floats(0.1, 5),
    outages_per_minute=st.floats(0, 10),
    outage_s=st.floats(0.1, 5),
)


def grid_bps(link: Link) -> list[float]:
    """The rate in each tenth of a second."""
    return [step.rate_bps for step in link.steps for _ in range(round(10 * step.duration_s))]


@given(configs, st.integers(0, 2**70))
def test_links_go_from_a_rate_to_the_next_and_outages_change_nothing_between(
    config: GeneratorConfig, seed: int
) -> None:
    rates_bps = chain_rates_bps(config.variation)
    assert rates_bps == sorted(rates_bps)
    assert fmean(rates_bps) == pytest.approx(generator.MEAN_BPS)
    assert pstdev(rates_bps) / generator.MEAN_BPS == pytest.approx(config.variation)
    link, quiet = (generate(one, seed) for one in (config, replace(config, outages_per_minute=0)))
    places = [rates_bps.index(rate_bps) for rate_bps in grid_bps(quiet)]
    assert all(abs(b - a) <= 1 for a, b in pairwise(places))
    assert link.round_s == pytest.approx(generator.LENGTH_S)
    assert link.at(0).rate_bps > 0
    for with_bps, without_bps in zip(grid_bps(link), grid_bps(quiet), strict=True):
        assert with_bps in (0.0, without_bps)


def test_equal_seeds_give_equal_links() -> None:
    config = GeneratorConfig(outages_per_minute=4, outage_s=1.5, variation=0.7)
    link = generate(config, 2026)
    assert link.steps == generate(config, 2026).steps != generate(config, 2027).steps
    told = [(step.duration_s, round(step.rate_bps)) for step in link.steps[:3]]
    assert told == [(2.3, 6878462), (2.7, 4979838), (2.3, 0)]


def test_long_links_are_as_asked_for(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(generator, "LENGTH_S", 40_000.0)
    config = GeneratorConfig(variation=0.6, dwell_s=0.3, outages_per_minute=6, outage_s=2)
    link = generate(config, 0)
    outages = [step.duration_s for step in link.steps if step.rate_bps == 0]
    assert len(outages) / (link.round_s / 60) == pytest.approx(6, rel=0.1)
    assert fmean(outages) == pytest.approx(2, rel=0.1)
    loud_bps = [rate_bps for rate_bps in grid_bps(link) if rate_bps]
    assert fmean(loud_bps) == pytest.approx(generator.MEAN_BPS, rel=0.05)
    assert pstdev(loud_bps) / fmean(loud_bps) == pytest.approx(config.variation, rel=0.05)
    quiet = generate(replace(config, outages_per_minute=0.0), 0)
    slowest, *_, fastest = chain_rates_bps(config.variation)
    between = [step.duration_s for step in quiet.steps if slowest < step.rate_bps < fastest]
    assert fmean(between) == pytest.approx(config.dwell_s, rel=0.05)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"variation": 2.2}, "variation is 2.2"),
        ({"dwell_s": 0.05}, "dwell_s is 0.05"),
        ({"outage_s": 0.0}, "outage_s is 0"),
        ({"outages_per_minute": 60.0}, "do not fit into a minute"),
        ({"outages_per_minute": -1.0}, "-1.0 outages"),
    ],
)
def test_what_cannot_be_made_up(change: dict[str, Any], message: str) -> None:
    refused(InvalidError, message, GeneratorConfig, **change)
