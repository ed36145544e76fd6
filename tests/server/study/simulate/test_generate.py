"""Generated links: they have the requested properties, and are the same on every machine."""

from __future__ import annotations

import hashlib
import math
from dataclasses import replace
from itertools import pairwise
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from codec.errors import InvalidError
from server.abr.link.link import Link
from server.study.simulate.generate import GeneratorConfig, chain_rates_bps, generate
from tests.support.hostile import refused


@st.composite
def configs(draw: st.DrawFn) -> GeneratorConfig:
    num_rates = draw(st.integers(1, 16))
    outage_s = draw(st.floats(0.1, 5))
    return GeneratorConfig(
        mean_bps=draw(st.floats(1e6, 1e9)),
        variation=draw(st.floats(0, 0.59)) * math.sqrt(num_rates - 1),
        num_rates=num_rates,
        dwell_s=draw(st.floats(0.1, 5)),
        outages_per_minute=draw(st.floats(0, 0.99)) * 60 / (outage_s + 0.1),
        outage_s=outage_s,
        latency_s=draw(st.floats(0, 0.3)),
        length_s=draw(st.floats(0.1, 30)),
    )


seeds = st.integers(0, 2**70)


def grid_bps(link: Link) -> list[float]:
    """The rate in each tenth of a second."""
    return [step.rate_bps for step in link.steps for _ in range(round(10 * step.duration_s))]


@given(configs())
def test_the_rates_have_the_mean_and_the_variation_asked_for(config: GeneratorConfig) -> None:
    rates_bps = chain_rates_bps(config)
    mean_bps = math.fsum(rates_bps) / len(rates_bps)
    deviation_bps = math.sqrt(math.fsum((r - mean_bps) ** 2 for r in rates_bps) / len(rates_bps))
    assert len(rates_bps) == config.num_rates
    assert mean_bps == pytest.approx(config.mean_bps)
    assert deviation_bps / mean_bps == pytest.approx(config.variation, rel=1e-6, abs=1e-9)
    assert list(rates_bps) == sorted(rates_bps)


@given(configs(), seeds)
def test_links_go_from_a_rate_to_the_next(config: GeneratorConfig, seed: int) -> None:
    rates_bps = chain_rates_bps(config)
    quiet = generate(replace(config, outages_per_minute=0.0), seed)
    places = [rates_bps.index(rate_bps) for rate_bps in grid_bps(quiet)]
    if config.variation > 1e-6:
        assert all(abs(b - a) <= 1 for a, b in pairwise(places))
    assert quiet.round_s == pytest.approx(config.length_s, abs=0.051)
    assert {step.latency_s for step in quiet.steps} == {config.latency_s}
    assert all(a.rate_bps != b.rate_bps for a, b in pairwise(quiet.steps))


@given(configs(), seeds)
def test_outages_change_nothing_between_them(config: GeneratorConfig, seed: int) -> None:
    link = generate(config, seed)
    quiet = generate(replace(config, outages_per_minute=0.0), seed)
    assert link.at(0).rate_bps > 0
    for with_bps, without_bps in zip(grid_bps(link), grid_bps(quiet), strict=True):
        assert with_bps in (0.0, without_bps)


def test_a_link_is_the_same_to_the_bit_on_any_machine() -> None:
    config = GeneratorConfig(outages_per_minute=4, outage_s=1.5, variation=0.7)
    link = generate(config, 2026)
    told = "".join(f"{step.duration_s.hex()} {step.rate_bps.hex()}\n" for step in link.steps)
    assert hashlib.sha256(told.encode()).hexdigest() == (
        "c702dfe892ffe8a691a1847617b32f0974faf543e1b04a37a18f7d0d1e7a6b28"
    )


@pytest.mark.parametrize("seed", range(3))
def test_long_links_are_as_asked_for(seed: int) -> None:
    config = GeneratorConfig(
        variation=0.6, num_rates=4, dwell_s=0.3, outages_per_minute=6, outage_s=2, length_s=20_000
    )
    link = generate(config, seed)
    outages = [step.duration_s for step in link.steps if step.rate_bps == 0]
    assert len(outages) / (link.round_s / 60) == pytest.approx(6, rel=0.1)
    assert math.fsum(outages) / len(outages) == pytest.approx(2, rel=0.1)
    loud_bps = [rate_bps for rate_bps in grid_bps(link) if rate_bps]
    mean_bps = math.fsum(loud_bps) / len(loud_bps)
    assert mean_bps == pytest.approx(config.mean_bps, rel=0.05)
    variance = math.fsum((rate_bps - mean_bps) ** 2 for rate_bps in loud_bps) / len(loud_bps)
    assert math.sqrt(variance) / mean_bps == pytest.approx(config.variation, rel=0.05)
    quiet = generate(replace(config, outages_per_minute=0.0), seed)
    ends = {min(chain_rates_bps(config)), max(chain_rates_bps(config))}
    between = [step.duration_s for step in quiet.steps if step.rate_bps not in ends]
    assert math.fsum(between) / len(between) == pytest.approx(config.dwell_s, rel=0.05)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"mean_bps": 0.0}, "mean_bps is 0"),
        ({"variation": -0.1}, "variation is -0.1"),
        ({"variation": 2.2}, "with 8 rates it is at most 1.58"),
        ({"num_rates": 0}, "num_rates is 0"),
        ({"num_rates": 1000}, "num_rates is 1000"),
        ({"dwell_s": 0.05}, "dwell_s is 0.05"),
        ({"outage_s": 0.0}, "outage_s is 0"),
        ({"length_s": 1e9}, "length_s is 1000000000"),
        ({"latency_s": -1.0}, "latency_s is -1"),
        ({"outages_per_minute": 60.0}, "do not fit into a minute"),
    ],
)
def test_what_cannot_be_made_up(change: dict[str, Any], message: str) -> None:
    refused(InvalidError, message, GeneratorConfig, **change)
    refused(InvalidError, "seed is -1", generate, GeneratorConfig(), -1)
