"""Regions of space by which Gaussians are kept or removed."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from codec.arrays import Doubles, Flags
from codec.errors import InvalidError


@dataclass(frozen=True, slots=True)
class Box:
    """A box along the axes. Raises InvalidError for one without an inside."""

    lower: Doubles  # (3,) metres
    upper: Doubles  # (3,) metres

    def __post_init__(self) -> None:
        if not (np.isfinite([self.lower, self.upper]).all() and (self.lower < self.upper).all()):
            raise InvalidError(
                f"box {_text(self.lower)} {_text(self.upper)}: the first corner must lie below the "
                "second on each axis"
            )

    def holds(self, means: Doubles) -> Flags:
        """(N,) which of (N, 3) `means` are inside."""
        outside = np.maximum(self.lower - means, means - self.upper).max(axis=1, initial=-np.inf)
        inside: Flags = outside <= 0
        return inside

    def box(self) -> tuple[Doubles, Doubles]:
        """(3,) lower and upper corner, metres."""
        return self.lower, self.upper


@dataclass(frozen=True, slots=True)
class Sphere:
    """A ball. Raises InvalidError for one without an inside."""

    centre: Doubles  # (3,) metres
    radius_m: float

    def __post_init__(self) -> None:
        if not (np.isfinite([*self.centre, self.radius_m]).all() and self.radius_m > 0):
            raise InvalidError(
                f"sphere {_text(self.centre)} {self.radius_m:g}: the radius must be above 0"
            )

    def holds(self, means: Doubles) -> Flags:
        """(N,) which of (N, 3) `means` are inside."""
        inside: Flags = ((means - self.centre) ** 2).sum(axis=1) <= self.radius_m**2
        return inside

    def box(self) -> tuple[Doubles, Doubles]:
        """(3,) lower and upper corner, metres, of a box around it."""
        return self.centre - self.radius_m, self.centre + self.radius_m


Region = Box | Sphere


def _text(values: Doubles) -> str:
    return " ".join(f"{value:g}" for value in values)
