"""By how much takes lag behind each other, from how alike each two of them are at each lag."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from scipy.fft import irfft, next_fast_len, rfft
from scipy.sparse.csgraph import breadth_first_order, minimum_spanning_tree

from codec.arrays import Doubles, Longs

Curve = tuple[Longs, Doubles]
"""Shifts, and how alike two takes are if the second lags by so much."""

LEAST_OVERLAP = 0.3
"""Share of the shorter series that two must have in common."""

ROUNDS = 5
"""How often each take is compared with all others at their lags: that is better than any one."""

WINDOWS = 6
"""Parts of the common time whose lags are found on their own, for spread and drift."""


@dataclass(frozen=True, slots=True, eq=False)
class Lags:
    """Of each take, in samples; NaN for those that are compared with no other."""

    lags: Doubles  # (C,) the sample of each that shows a moment of all
    score: Doubles  # (C,) how alike it is to the others, in the mean
    rest: Doubles  # (C,) the largest score at other lags


def lags_of(curves: Mapping[tuple[int, int], Curve], count: int, guard: int) -> Lags:
    """The lags of `count` takes; guard: lags so near to the best one are the same peak."""
    cost = np.zeros((count, count))
    for (i, j), (shifts, alike) in curves.items():
        best = int(np.argmax(alike))
        far = alike[np.abs(shifts - shifts[best]) > guard]
        cost[i, j] = 3.0 - min(alike[best] - far.max(initial=-1.0), 2.0)
    lags, score, rest = (np.full(count, np.nan) for _ in range(3))
    if not curves:
        return Lags(lags, score, rest)
    # First along the pairs that are clearest.
    tree = minimum_spanning_tree(cost)
    order, before = breadth_first_order(tree, min(min(curves)), directed=False)
    whole = {int(order[0]): 0}
    for i in map(int, order[1:]):
        at = int(before[i])
        if (at, i) in curves:
            shifts, alike = curves[at, i]
            whole[i] = whole[at] + int(shifts[np.argmax(alike)])
        else:
            shifts, alike = curves[i, at]
            whole[i] = whole[at] - int(shifts[np.argmax(alike)])
    for _ in range(ROUNDS):
        for i in whole:
            shifts, total = _joined(curves, i, whole)
            best = int(np.argmax(total))
            whole[i] = int(shifts[best])
            lags[i], score[i] = shifts[best] + _peak(total, best), total[best]
            rest[i] = total[np.abs(shifts - shifts[best]) > guard].max(initial=0.0)
    return Lags(lags, score, rest)


def _joined(curves: Mapping[tuple[int, int], Curve], take: int, lags: Mapping[int, int]) -> Curve:
    """How alike a take is, at each lag, to all others at theirs."""
    parts = [
        (shifts + lags[i], alike) if take == j else (lags[j] - shifts[::-1], alike[::-1])
        for (i, j), (shifts, alike) in curves.items()
        if take in (i, j) and i in lags and j in lags
    ]
    first, last = min(s[0] for s, _ in parts), max(s[-1] for s, _ in parts)
    total = np.zeros(last - first + 1)
    for shifts, alike in parts:
        np.add.at(total, shifts - first, alike / len(parts))
    return np.arange(first, last + 1), total


def _peak(alike: Doubles, best: int) -> float:
    """Where between samples the peak of a parabola through three of them is."""
    if not 0 < best < len(alike) - 1:
        return 0.0
    left, middle, right = alike[best - 1 : best + 2]
    bend = left - 2 * middle + right
    return float(np.clip((left - right) / (2 * bend), -0.5, 0.5)) if bend < 0 else 0.0


def series_lags(series: Sequence[Doubles], guard: int) -> tuple[Lags, Doubles, Doubles]:
    """The lags of series (T,), each of its own length; their spread, in samples, and drift, in
    samples a sample, over parts of the common time: (C,), NaN if that is too short."""
    count = len(series)
    pairs = [(i, j) for i in range(count) for j in range(i + 1, count)]
    whole = lags_of({(i, j): correlate(series[i], series[j]) for i, j in pairs}, count, guard)
    starts = np.rint(whole.lags).astype(int)
    first = int((-starts).max())
    last = min(len(each) - start for each, start in zip(series, starts, strict=True))
    edges = np.linspace(first, last, WINDOWS + 1).astype(int)
    if edges[1] - edges[0] < 8 * guard:
        return whole, np.full(count, np.nan), np.full(count, np.nan)
    found = []
    for a, b in pairwise(edges):
        parts = [each[a + start : b + start] for each, start in zip(series, starts, strict=True)]
        curves = {}
        for i, j in pairs:
            shifts, alike = correlate(parts[i], parts[j])
            near = np.abs(shifts) <= guard
            curves[i, j] = shifts[near], alike[near]
        lags = lags_of(curves, count, guard).lags
        found.append(lags - np.median(lags))
    slopes = np.polyfit((edges[:-1] + edges[1:]) / 2, np.array(found), 1)[0]
    return whole, np.std(found, axis=0), slopes


def correlate(one: Doubles, other: Doubles) -> Curve:
    """Correlations of other[t + shift] with one[t], where they overlap enough. By chance, what
    overlaps little is often alike: the less they do, the less it counts."""
    one, other = (each - each.mean() for each in (one, other))
    size = next_fast_len(len(one) + len(other), real=True)

    def against(a: Doubles, b: Doubles) -> Doubles:
        sums = irfft(np.conj(rfft(a, size)) * rfft(b, size), size)
        return np.concatenate([sums[size - len(one) + 1 :], sums[: len(other)]])

    overlap = against(np.ones(len(one)), np.ones(len(other)))
    share = np.minimum(overlap / min(len(one), len(other)), 1)
    enough = share >= LEAST_OVERLAP
    # Each part that overlaps is judged by its own size: a loud end must not win by itself.
    energies = against(one**2, np.ones(len(other))) * against(np.ones(len(one)), other**2)
    alike = against(one, other)[enough] / np.sqrt(np.maximum(energies[enough], 1e-12))
    shifts = np.arange(1 - len(one), len(other))[enough]
    return shifts, alike * np.sqrt(share[enough])
