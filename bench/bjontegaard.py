"""The area between two curves of rate against PSNR, as video codecs are compared: BD-PSNR and
BD-rate (Bjontegaard, VCEG-M33), between points by piecewise cubic Hermite interpolation
(JCTVC-B055).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.interpolate import PchipInterpolator

Doubles = npt.NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class RatePoint:
    """One way to show a scene."""

    bytes_per_frame: float
    psnr_db: float


def rising(points: Sequence[RatePoint]) -> list[RatePoint]:
    """The points that no other one beats with fewer bytes, in the order of their bytes."""
    kept: list[RatePoint] = []
    for point in sorted(points, key=lambda p: (p.bytes_per_frame, -p.psnr_db)):
        if not kept or point.psnr_db > kept[-1].psnr_db:
            kept.append(point)
    return kept


def _mean_difference(x: Doubles, y: Doubles, base_x: Doubles, base_y: Doubles) -> float | None:
    """The mean of y - base_y over the x that both curves have; None if there is none."""
    low, high = max(x[0], base_x[0]), min(x[-1], base_x[-1])
    if len(x) < 2 or len(base_x) < 2 or not low < high:
        return None
    areas = [PchipInterpolator(*of).integrate(low, high) for of in ((x, y), (base_x, base_y))]
    return float(areas[0] - areas[1]) / float(high - low)


def _curve(points: Sequence[RatePoint]) -> tuple[Doubles, Doubles]:
    """(N,) log10 of the rates, and (N,) PSNR in dB, of the points that rise."""
    kept = rising(points)
    return np.log10([p.bytes_per_frame for p in kept]), np.array([p.psnr_db for p in kept])


def bd_psnr_db(points: Sequence[RatePoint], base: Sequence[RatePoint]) -> float | None:
    """How many dB the curve `points` lies above `base` at equal rates, on average over the
    logarithm of the rates that both have; None if they share none."""
    return _mean_difference(*_curve(points), *_curve(base))


def bd_rate(points: Sequence[RatePoint], base: Sequence[RatePoint]) -> float | None:
    """How much more rate the curve `points` needs than `base` at equal PSNR, of 1, on average over
    the PSNR that both have; None if they share none."""
    (x, y), (base_x, base_y) = _curve(points), _curve(base)
    mean = _mean_difference(y, x, base_y, base_x)
    return None if mean is None else math.expm1(mean * math.log(10))
