"""Made-up links: rates that wander around a mean, and outages. Equal seeds give equal links."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import groupby

import numpy as np

from codec.errors import InvalidError
from server.abr.link import Link, LinkStep

GRID_S = 0.1
"""Rates change, and outages begin and end, at multiples of this only, seconds."""
LENGTH_S = 300.0
"""Length of a link before it repeats, seconds."""
MEAN_BPS = 20e6
"""Mean rate outside outages, bits per second; a load scales it."""
NUM_RATES = 8
"""Number of rates; each is the next lower one times a constant. All are equally likely."""
MAX_VARIATION = 1.5
"""With NUM_RATES rates, 2.6 would need an infinite ratio between them."""


@dataclass(frozen=True, slots=True)
class GeneratorConfig:
    """Properties of generated links; each holds in the long run, not in every link."""

    variation: float = 0.5
    """Coefficient of variation of the rate outside outages: standard deviation over mean."""
    dwell_s: float = 1.0
    """Mean seconds at a rate before the link goes to the next higher or lower rate; twice as long
    at the lowest and the highest rate."""
    outages_per_minute: float = 0.0
    """Mean number of outages that begin in a minute."""
    outage_s: float = 1.0
    """Mean length of an outage, seconds."""

    def __post_init__(self) -> None:
        if not 0 <= self.variation <= MAX_VARIATION:
            raise InvalidError(f"variation is {self.variation}; it must be 0 to {MAX_VARIATION}")
        for name in ("dwell_s", "outage_s"):
            if not GRID_S <= getattr(self, name) <= LENGTH_S:
                raise InvalidError(
                    f"{name} is {getattr(self, name)}; it must be {GRID_S} to {LENGTH_S:g}"
                )
        if not 0 <= self.outages_per_minute * (self.outage_s + GRID_S) <= 60:
            raise InvalidError(
                f"{self.outages_per_minute} outages of {self.outage_s} s do not fit into a minute"
            )


def generate(config: GeneratorConfig, seed: int, latency_s: float = 0.02) -> Link:
    """The link of `seed`, from 0 on. It never begins with an outage.

    With the same seed, links with and without outages have the same rates between them.
    """
    moves, changes = np.random.default_rng(seed).random((2, round(LENGTH_S / GRID_S)))
    rates_bps = chain_rates_bps(config.variation)
    number, is_out = int(moves[0] * NUM_RATES), False
    move = GRID_S / config.dwell_s
    # A minute is so many outages, and what lies between them.
    between_s = 60 - config.outages_per_minute * config.outage_s
    begin, end = config.outages_per_minute * GRID_S / between_s, GRID_S / config.outage_s
    grid_bps = [rates_bps[number]]
    for chance, change in zip(moves[1:], changes[1:], strict=True):
        if chance < move:  # a walk that no rate draws to itself
            number += -1 if chance < move / 2 else 1
            number = min(max(0, number), NUM_RATES - 1)
        is_out = change >= end if is_out else change < begin
        grid_bps.append(0.0 if is_out else rates_bps[number])
    return Link(
        [
            LinkStep(round(GRID_S * len(list(spell)), 1), rate_bps, latency_s)
            for rate_bps, spell in groupby(grid_bps)
        ]
    )


def chain_rates_bps(variation: float) -> list[float]:
    """The rates that links go between, from low to high: of the mean and variation asked for."""
    low, high = 1.0, 32.0
    for _ in range(60):  # more than the bits of a float
        middle = (low + high) / 2
        powers = middle ** np.arange(NUM_RATES)
        low, high = (middle, high) if powers.std() < variation * powers.mean() else (low, middle)
    powers = low ** np.arange(NUM_RATES)
    return [float(rate_bps) for rate_bps in MEAN_BPS * powers / powers.mean()]
