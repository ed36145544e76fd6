"""Made-up links: rates that wander around a mean, and outages.

Rule: the same seed gives the same link on any machine and with any numpy. So chance comes from the
raw bits of PCG64, which numpy keeps for ever, and numbers go through nothing but + - * / sqrt fsum,
which IEEE 754 rounds in one way only.
"""

from __future__ import annotations

import math
import operator
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import accumulate, groupby

import numpy as np

from codec.errors import InvalidError
from server.abr.link.link import Link, LinkStep

GRID_MS = 100
"""Rates change, and outages begin and end, at multiples of this only, milliseconds."""

MAX_LENGTH_S = 100_000.0
MAX_MEAN_BPS = 1e15
MAX_RATES = 16

_GRID_S = GRID_MS / 1000
_MOST_VARIATION = 0.6
"""Largest variation as a share of the limit for `num_rates` rates, which needs infinite ratios."""


@dataclass(frozen=True, slots=True)
class GeneratorConfig:
    """Properties of generated links; each holds in the long run, not in every link."""

    mean_bps: float = 20e6
    """Mean rate outside outages, bits per second."""
    variation: float = 0.5
    """Coefficient of variation of the rate outside outages: standard deviation over mean."""
    num_rates: int = 8
    """Number of rates; each is the next lower rate times a constant. All are equally likely."""
    dwell_s: float = 1.0
    """Mean seconds at a rate before the link goes to the next higher or lower rate; twice as long
    at the lowest and the highest rate."""
    outages_per_minute: float = 0.0
    """Mean number of outages that begin in a minute."""
    outage_s: float = 1.0
    """Mean length of an outage, seconds."""
    latency_s: float = 0.02
    """Constant latency, seconds."""
    length_s: float = 300.0
    """Length of the link before it repeats, seconds."""

    def __post_init__(self) -> None:
        for field in ("variation", "outages_per_minute", "latency_s"):
            if not (math.isfinite(getattr(self, field)) and getattr(self, field) >= 0):
                raise InvalidError(f"{field} is {getattr(self, field)}; it must be at least 0")
        if not 1 <= self.mean_bps <= MAX_MEAN_BPS:
            raise InvalidError(f"mean_bps is {self.mean_bps}; it must be 1 to {MAX_MEAN_BPS:g}")
        for field in ("dwell_s", "outage_s", "length_s"):
            if not _GRID_S <= getattr(self, field) <= MAX_LENGTH_S:
                raise InvalidError(
                    f"{field} is {getattr(self, field)}; it must be {_GRID_S:g} to {MAX_LENGTH_S:g}"
                )
        if not 1 <= self.num_rates <= MAX_RATES:
            raise InvalidError(f"num_rates is {self.num_rates}; it must be 1 to {MAX_RATES}")
        most = _MOST_VARIATION * math.sqrt(self.num_rates - 1)
        if self.variation > most:
            raise InvalidError(
                f"variation is {self.variation}; with {self.num_rates} rates it is at most {most:g}"
            )
        if self.outages_per_minute * (self.outage_s + _GRID_S) > 60:
            raise InvalidError(
                f"{self.outages_per_minute} outages of {self.outage_s} s do not fit into a minute"
            )


def generate(config: GeneratorConfig, seed: int) -> Link:
    """The link of `seed`, from 0 on. It never begins with an outage.

    With the same seed, links with and without outages have the same rates between them.
    """
    if seed < 0:
        raise InvalidError(f"seed is {seed}; it must be at least 0")
    count = round(config.length_s / _GRID_S)
    # The upper 53 bits as a fraction from 0 to 1: exact.
    chances = ((np.random.PCG64(seed).random_raw(2 * count) >> 11) * 2.0**-53).tolist()
    rates_bps = chain_rates_bps(config)
    grid_bps = [
        0.0 if out else rates_bps[number]
        for number, out in zip(
            _wander(config, chances[:count]), _outages(config, chances[count:]), strict=True
        )
    ]
    return Link(
        [
            LinkStep(sum(1 for _ in spell) * GRID_MS / 1000, rate_bps, config.latency_s)
            for rate_bps, spell in groupby(grid_bps)
        ]
    )


def chain_rates_bps(config: GeneratorConfig) -> tuple[float, ...]:
    """The rates that links go between, from low to high: of the mean and variation asked for."""
    low, high = 1.0, 2.0
    while _variation(_powers(high, config.num_rates)) < config.variation:
        high *= 2
    for _ in range(60):  # more than the bits of a float
        middle = (low + high) / 2
        if _variation(_powers(middle, config.num_rates)) < config.variation:
            low = middle
        else:
            high = middle
    powers = _powers(low, config.num_rates)
    unit_bps = config.mean_bps * config.num_rates / math.fsum(powers)
    return tuple(unit_bps * power for power in powers)


def _powers(ratio: float, count: int) -> list[float]:
    """1, ratio, ratio squared, and so on."""
    return list(accumulate([ratio] * (count - 1), operator.mul, initial=1.0))


def _variation(values: list[float]) -> float:
    """Standard deviation over mean."""
    mean = math.fsum(values) / len(values)
    return math.sqrt(math.fsum((x - mean) * (x - mean) for x in values) / len(values)) / mean


def _wander(config: GeneratorConfig, chances: list[float]) -> Iterator[int]:
    """The number of the rate at each point of the grid: a walk that no rate draws to itself."""
    move = _GRID_S / config.dwell_s
    number = int(chances[0] * config.num_rates)
    yield number
    for chance in chances[1:]:
        if chance < move / 2:
            number = max(0, number - 1)
        elif chance < move:
            number = min(config.num_rates - 1, number + 1)
        yield number


def _outages(config: GeneratorConfig, chances: list[float]) -> Iterator[bool]:
    """Whether there is an outage, at each point of the grid."""
    # A minute is so many outages, and what lies between them.
    between_s = 60 - config.outages_per_minute * config.outage_s
    begin = config.outages_per_minute * _GRID_S / between_s
    end = _GRID_S / config.outage_s
    out = False
    yield out
    for chance in chances[1:]:
        out = chance >= end if out else chance < begin
        yield out
