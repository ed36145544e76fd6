"""Which Gaussian of a file goes on in the next file.

Rule: the same files give the same pairs. A wrong pair costs bytes, never precision: what a stream
sends of a Gaussian is held against the file, whatever was there before.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from scipy.spatial import cKDTree

from codec.pose import Doubles
from codec.splats import SH_C0, Splats

Rows = npt.NDArray[np.int64]
Flags = npt.NDArray[np.bool_]
Keys = npt.NDArray[np.uint64]

ALIKE = (0.5, 0.5, 0.3, 0.15, 0.15, 0.15)
"""How far the looks of a Gaussian may differ from file to file: the logarithms of its two larger
standard deviations, its opacity, its colour."""

ORDER_SHARE = 0.5
"""Of the Gaussians at the same place in two files, the share that must be alike for the order of
the files to mean something."""

ORDER_REACH = 0.1
"""How far a Gaussian may go in a frame where the order tells, as a share of the scene's extent."""

REACH = 4.0
"""How far a Gaussian may go in a frame where it does not, as a multiple of its size."""

NEIGHBOURS = 4
"""Nearest Gaussians that are looked at."""

ROUNDS = 3
"""How often those that lost their nearest to another one look again."""


def row_keys(splats: Splats) -> Keys:
    """(N,) uint64 that tell Gaussians apart: equal for equal bits, hardly ever for others."""
    count = len(splats)
    keys = np.zeros(count, np.uint64)
    for array in splats.arrays:
        for column in array.reshape(count, -1).T if count else ():
            keys ^= np.ascontiguousarray(column).view(np.uint32)
            keys *= np.uint64(0x9E3779B97F4A7C15)
            keys ^= keys >> np.uint64(29)
    return keys


def match(before: Splats, after: Splats) -> tuple[Rows, Flags]:
    """(N,) the row of `before` that each Gaussian of `after` continues, or -1; and which of them
    are the same bit by bit. No row is continued twice.

    Bits come first, then the order of the files where it means something, then place and looks.
    """
    continued = _equal_pairs(before, after)
    same = continued >= 0
    for pair in (_pair_by_order, _pair_by_place):
        old = np.ones(len(before), np.bool_)
        old[continued[continued >= 0]] = False
        left, right = np.flatnonzero(old), np.flatnonzero(continued < 0)
        if not len(left) or not len(right):
            break
        pair(before, after, left, right, continued)
    return continued, same


def _equal_pairs(before: Splats, after: Splats) -> Rows:
    """(N,) the row of the same bits, the one at the same place first; or -1."""
    continued = np.full(len(after), -1, np.int64)
    both = min(len(before), len(after))
    old, new = row_keys(before), row_keys(after)
    stays = np.flatnonzero(old[:both] == new[:both])
    stays = stays[_same_bits(before, stays, after, stays)]
    continued[stays] = stays
    left, right = _rest(len(before), stays), _rest(len(after), stays)
    # Sorted by key, then by place; the n-th of a key goes to the n-th of the same key.
    left = left[np.argsort(old[left], kind="stable")]
    right = right[np.argsort(new[right], kind="stable")]
    first = np.searchsorted(new[right], new[right])
    at = np.searchsorted(old[left], new[right]) + np.arange(len(right)) - first
    found = np.flatnonzero(at < len(left))
    found = found[old[left[at[found]]] == new[right[found]]]
    a, b = left[at[found]], right[found]
    equal = _same_bits(before, a, after, b)
    continued[b[equal]] = a[equal]
    return continued


def _rest(count: int, rows: Rows) -> Rows:
    """Those of 0..count-1 that are not in `rows`."""
    rest = np.ones(count, np.bool_)
    rest[rows] = False
    return np.flatnonzero(rest)


def _same_bits(before: Splats, a: Rows, after: Splats, b: Rows) -> Flags:
    """(M,) whether Gaussian a[i] of `before` has the bits of b[i] of `after`."""
    same = np.ones(len(a), np.bool_)
    for x, y in zip(before.arrays, after.arrays, strict=True):
        bits = x[a].view(np.uint32) == y[b].view(np.uint32)
        same &= bits.reshape(len(a), -1).all(axis=1) if len(a) else True
    return same


def _looks(splats: Splats) -> Doubles:
    """(N, 6) what Gaussians look like, in units of ALIKE."""
    sizes = np.sort(splats.log_scales.astype(np.float64), axis=1)[:, :0:-1]
    colours = np.clip(0.5 + SH_C0 * splats.sh[:, 0].astype(np.float64), 0, 1)
    return np.column_stack([sizes, splats.opacities, colours]) / ALIKE


def _pair_by_order(
    before: Splats, after: Splats, left: Rows, right: Rows, continued: Rows
) -> None:
    """Fills `continued` where what stands at the same place of both files is alike, if it mostly
    is: of all rows, or, if as many are left, of these alone."""
    pairs = []
    if len(left) == len(right):
        pairs.append((left, right))
    stays = np.intersect1d(left, right, assume_unique=True)
    pairs.append((stays, stays))
    extent = float(np.ptp(np.quantile(before.means[left], (0.02, 0.98), axis=0), axis=0).max())
    best = (0, pairs[0][0][:0], pairs[0][1][:0])
    for a, b in pairs:
        if not len(a):
            continue
        looks = abs(_looks(before.take(a)) - _looks(after.take(b))).max(axis=1) <= 1
        moves_m = np.linalg.norm(before.means[a].astype(np.float64) - after.means[b], axis=1)
        sizes_m = np.exp(before.log_scales[a].astype(np.float64).max(axis=1))
        alike = looks & (moves_m <= ORDER_REACH * extent + sizes_m)
        if alike.mean() >= ORDER_SHARE and alike.sum() > best[0]:
            best = (int(alike.sum()), a[alike], b[alike])
    continued[best[2]] = best[1]


def _pair_by_place(
    before: Splats, after: Splats, left: Rows, right: Rows, continued: Rows
) -> None:
    """Fills `continued` with pairs each of which is the other's nearest, in place and looks."""
    for _ in range(ROUNDS):
        old, new = before.take(left), after.take(right)
        looks = _looks(old), _looks(new)
        reach_m = REACH * np.exp(np.sort(old.log_scales.astype(np.float64), axis=1)[:, 1:].mean(1))
        to_old = _nearest(new, looks[1], old, looks[0], reach_m, False)
        to_new = _nearest(old, looks[0], new, looks[1], reach_m, True)
        mutual = np.flatnonzero(to_old >= 0)
        mutual = mutual[to_new[to_old[mutual]] == mutual]
        if not len(mutual):
            return
        continued[right[mutual]] = left[to_old[mutual]]
        left, right = np.delete(left, to_old[mutual]), np.delete(right, mutual)
        if not len(left) or not len(right):
            return


def _nearest(
    asking: Splats,
    asking_looks: Doubles,
    others: Splats,
    looks: Doubles,
    reach_m: Doubles,
    reach_of_asking: bool,
) -> Rows:
    """(N,) for each of `asking` the best of its nearest among `others`, or -1."""
    count = min(NEIGHBOURS, len(others))
    distances, found = cKDTree(others.means.astype(np.float64)).query(
        asking.means.astype(np.float64), k=count
    )
    distances, found = distances.reshape(-1, count), found.reshape(-1, count)
    reaches = reach_m[:, None] if reach_of_asking else reach_m[found]
    apart = abs(asking_looks[:, None] - looks[found])
    costs = (distances / reaches) ** 2 + (apart**2).sum(axis=2)
    costs[(distances > reaches) | (apart.max(axis=2) > 1)] = np.inf
    best = np.argmin(costs, axis=1)
    rows = np.arange(len(asking))
    return np.where(np.isfinite(costs[rows, best]), found[rows, best], -1)
