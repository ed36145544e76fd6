"""A rate as the user writes it: `8M`, bits per second with k, M or G."""

from __future__ import annotations

RATE_PATTERN = r"(\d+(?:\.\d+)?)([kMG]?)"
"""Matches a rate: its number and its prefix."""

_PREFIXES = {"": 1.0, "k": 1e3, "M": 1e6, "G": 1e9}


def rate_bps(number: str, prefix: str) -> float:
    """The rate of what RATE_PATTERN has matched."""
    return float(number) * _PREFIXES[prefix]
