"""How far a policy is ahead, and how sure that is: the percentile bootstrap (Efron 1979).

Rule: the same values and seed give the same interval on any machine and with any numpy. So chance
comes from the raw bits of PCG64, and sums are taken in the order of the values.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from statistics import fmean

import numpy as np

from codec.errors import InvalidError
from server.study.study import Play

RESAMPLES = 10_000
LEVEL = 0.95


@dataclass(frozen=True, slots=True)
class Interval:
    """A mean, and where that of other draws from the same source would lie."""

    mean: float
    low: float
    high: float


def mean_interval(
    values: Sequence[float], seed: int, resamples: int = RESAMPLES, level: float = LEVEL
) -> Interval:
    """The mean of `values`, at least one, and the interval that holds `level` of the means of
    `resamples` draws of as many from them. Raises InvalidError."""
    count = len(values)
    if not count or resamples < 1 or not 0 < level < 1:
        raise InvalidError(f"a bootstrap of {count} values, {resamples} draws, level {level}")
    bits = np.random.PCG64(seed)
    array = np.array(values, np.float64)
    sums = np.zeros(resamples)
    for _ in range(count):
        chances = (bits.random_raw(resamples) >> 11) * 2.0**-53  # exact
        sums += array[(chances * count).astype(np.int64)]
    means = np.sort(sums / count)
    beyond = int((1 - level) / 2 * resamples)
    low, high = float(means[beyond]), float(means[resamples - 1 - beyond])
    return Interval(math.fsum(values) / count, low, high)


def ahead_db(own: Sequence[Play], others: Sequence[Play], seed: int) -> Interval:
    """QoE of `own` plays less that of `others` in the same cases, dB, trace by trace: the loads of
    one trace are not independent draws, so their mean counts as one."""
    by_trace: dict[str, list[float]] = {}
    for play, other in zip(own, others, strict=True):
        by_trace.setdefault(play.trace, []).append(play.quality_db - other.quality_db)
    return mean_interval([fmean(differences) for differences in by_trace.values()], seed)
