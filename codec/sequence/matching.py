"""Which Gaussian of a file goes on in the next file.

Rule: the same files give the same pairs. A wrong pair costs bytes, never precision: what a stream
sends of a Gaussian is held against the file, whatever was there before.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from codec.arrays import Doubles, Flags, Floats, Longs
from codec.kernel import kernel
from codec.splats import SH_C0, Splats

Keys = npt.NDArray[np.uint64]

ALIKE = (0.5, 0.5, 0.3, 0.15, 0.15, 0.15)
"""How far the looks of a Gaussian may differ from file to file: the logarithms of its two larger
standard deviations, its opacity, its colour."""

ORDER_SHARE = 0.5
"""Share of the Gaussians at equal places in two files that must be alike for the order of the files
to identify them."""

ORDER_REACH = 0.1
"""Largest motion in a frame where the order or the colours identify Gaussians, as a share of the
scene's extent."""

REACH = 4.0
"""Largest motion in a frame where it does not, as a multiple of the Gaussian's size."""

NEIGHBOURS = 4
"""Nearest Gaussians that are candidates for a match."""

FLOW_ROUNDS, FLOW_NEIGHBOURS = 2, 8
"""Rounds in which a Gaussian follows its neighbours' motion, and neighbours that it follows."""

FLOW_SAMPLES = 1 << 13
"""Gaussians that are looked at for that."""

ROUNDS = 3
"""How often those that lost their nearest to another one look again."""


def row_keys(splats: Splats) -> Keys:
    """(N,) uint64 that identify Gaussians: equal for equal bits, hardly ever for others."""
    return _keys(splats.arrays)


def _keys(arrays: Sequence[Floats]) -> Keys:
    """(N,) the keys of the rows of `arrays`."""
    count = len(arrays[0])
    keys = np.zeros(count, np.uint64)
    for array in arrays if count else ():
        _stir(np.ascontiguousarray(array).reshape(count, -1).view(np.uint32), keys)
    return keys


@kernel(nogil=True)
def _stir(words, keys):  # type: ignore[no-untyped-def]
    """Stirs the words of each row into its key."""
    for i in range(words.shape[0]):
        key = keys[i]
        for column in range(words.shape[1]):
            key = (key ^ np.uint64(words[i, column])) * np.uint64(0x9E3779B97F4A7C15)
            key ^= key >> np.uint64(29)
        keys[i] = key


def match(before: Splats, after: Splats) -> tuple[Longs, Flags]:
    """(N,) the row of `before` that each Gaussian of `after` continues, or -1; and which of them
    are the same bit by bit. No row is continued twice.

    Bits come first, then the bits of the colours alone, then the order of the files where it means
    something, then place and looks.
    """
    if len(before) == len(after) and all(map(np.array_equal, before.arrays, after.arrays)):
        return np.arange(len(after)), np.ones(len(after), np.bool_)
    continued = _equal_pairs(before, after)
    same = continued >= 0
    for pair in (_pair_by_colours, _pair_by_order, _pair_by_place):
        old = np.ones(len(before), np.bool_)
        old[continued[continued >= 0]] = False
        left, right = np.flatnonzero(old), np.flatnonzero(continued < 0)
        if not len(left) or not len(right):
            break
        pair(before, after, left, right, continued)
    return continued, same


def _equal_pairs(before: Splats, after: Splats) -> Longs:
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


def _rest(count: int, rows: Longs) -> Longs:
    """The numbers of 0..count-1 that are not in `rows`."""
    rest = np.ones(count, np.bool_)
    rest[rows] = False
    return np.flatnonzero(rest)


def _same_bits(before: Splats, a: Longs, after: Splats, b: Longs) -> Flags:
    """(M,) whether Gaussian a[i] of `before` has the bits of b[i] of `after`."""
    same = np.ones(len(a), np.bool_)
    for x, y in zip(before.arrays, after.arrays, strict=True):
        bits = x[a].view(np.uint32) == y[b].view(np.uint32)
        same &= bits.reshape(len(a), -1).all(axis=1) if len(a) else True
    return same


def _looks(splats: Splats, rows: Longs) -> Doubles:
    """(M, 6) what the Gaussians `rows` look like, in units of ALIKE."""
    looks = np.empty((len(rows), len(ALIKE)))
    _fill_looks(splats.log_scales, splats.logit_opacities, splats.sh, rows, looks)
    return looks / ALIKE


@kernel(nogil=True)
def _fill_looks(log_scales, logit_opacities, sh, rows, looks):  # type: ignore[no-untyped-def]
    """Fills the last: the larger two log-scales, the opacity, the colour."""
    for i in range(rows.shape[0]):
        row = rows[i]
        x = np.float64(log_scales[row, 0])
        y = np.float64(log_scales[row, 1])
        z = np.float64(log_scales[row, 2])
        looks[i, 0] = max(x, y, z)
        looks[i, 1] = max(min(x, y), min(max(x, y), z))
        looks[i, 2] = 0.5 + 0.5 * np.tanh(0.5 * np.float64(logit_opacities[row]))
        for channel in range(3):
            colour = 0.5 + SH_C0 * np.float64(sh[row, 0, channel])
            looks[i, 3 + channel] = min(max(colour, 0.0), 1.0)


def _pair_by_colours(
    before: Splats, after: Splats, left: Longs, right: Longs, continued: Longs
) -> None:
    """Fills `continued` where the colours have the same bits, which no other Gaussian of either
    file has: what a deformation network moves keeps them."""
    old, i = _alone(_keys([before.sh[left]]))
    new, j = _alone(_keys([after.sh[right]]))
    at = np.searchsorted(old, new)
    found = np.flatnonzero(at < len(old))
    found = found[old[at[found]] == new[found]]
    a, b = left[i[at[found]]], right[j[found]]
    alike = _are_alike(before, after, a, b, _extent_m(before, left))
    continued[b[alike]] = a[alike]


def _alone(keys: Keys) -> tuple[Keys, Longs]:
    """The keys that are there once, rising, and where."""
    order = np.argsort(keys)
    rising = keys[order]
    ends = np.ones(len(keys) + 1, np.bool_)  # where another key begins
    ends[1:-1] = rising[1:] != rising[:-1]
    once = ends[1:] & ends[:-1]
    return rising[once], order[once]


def _extent_m(splats: Splats, rows: Longs) -> float:
    """The longest side of a box around most of the Gaussians `rows`, metres."""
    edges = np.quantile(splats.means[rows], (0.02, 0.98), axis=0)
    return float(np.ptp(edges, axis=0).max())


def _are_alike(before: Splats, after: Splats, a: Longs, b: Longs, extent_m: float) -> Flags:
    """(M,) whether Gaussian a[i] of `before` may be b[i] of `after`, by its looks and by how far
    it has moved."""
    alike = np.empty(len(a), np.bool_)
    reach_m = ORDER_REACH * extent_m
    old, new = _looks(before, a), _looks(after, b)
    _compare(old, new, before.means, after.means, before.log_scales, a, b, reach_m, alike)
    return alike


@kernel(nogil=True)
def _compare(  # type: ignore[no-untyped-def]
    old_looks, new_looks, old_means, new_means, old_log_scales, a, b, reach_m, alike
):
    """Fills the last."""
    for i in range(a.shape[0]):
        apart = 0.0
        for kind in range(old_looks.shape[1]):
            apart = max(apart, abs(old_looks[i, kind] - new_looks[i, kind]))
        moved2, size = 0.0, -30.0
        for axis in range(3):
            moved2 += (np.float64(old_means[a[i], axis]) - np.float64(new_means[b[i], axis])) ** 2
            size = max(size, np.float64(old_log_scales[a[i], axis]))
        alike[i] = apart <= 1 and np.sqrt(moved2) <= reach_m + np.exp(min(size, 30.0))


def _pair_by_order(
    before: Splats, after: Splats, left: Longs, right: Longs, continued: Longs
) -> None:
    """Fills `continued` where what stands at the same place of both files is alike, if it mostly
    is: of all rows, or, if as many are left, of these alone."""
    pairs = []
    if len(left) == len(right):
        pairs.append((left, right))
    stays = np.intersect1d(left, right, assume_unique=True)
    pairs.append((stays, stays))
    extent_m = _extent_m(before, left)
    best = (0, pairs[0][0][:0], pairs[0][1][:0])
    for a, b in pairs:
        if not len(a):
            continue
        alike = _are_alike(before, after, a, b, extent_m)
        if alike.mean() >= ORDER_SHARE and alike.sum() > best[0]:
            best = (int(alike.sum()), a[alike], b[alike])
    continued[best[2]] = best[1]


def _pair_by_place(
    before: Splats, after: Splats, left: Longs, right: Longs, continued: Longs
) -> None:
    """Fills `continued` with pairs each of which is the other's nearest, in place and looks, once
    what goes one way with its neighbours is carried along."""
    old, new = _Cloud.of(before, left), _Cloud.of(after, right)
    sampled = np.arange(0, len(left), 1 + len(left) // FLOW_SAMPLES)
    for _ in range(FLOW_ROUNDS):
        a, b = _mutual(old, new, sampled)
        if len(a) < FLOW_NEIGHBOURS:
            break
        moves_m = new.means_m[b] - old.means_m[a]
        _, near = _nearest(old.means_m[a], old.means_m, FLOW_NEIGHBOURS)
        old = replace(old, guesses_m=old.means_m + np.median(moves_m[near], axis=1))
    for _ in range(ROUNDS):
        a, b = _mutual(old, new, np.arange(len(left)))
        if not len(a):
            return
        continued[right[b]] = left[a]
        rest, missing = _rest(len(left), a), _rest(len(right), b)
        if not len(rest) or not len(missing):
            return
        left, right, old, new = left[rest], right[missing], old.take(rest), new.take(missing)


@dataclass(frozen=True, slots=True)
class _Cloud:
    """The compared attributes of N Gaussians."""

    means_m: Doubles  # (N, 3)
    guesses_m: Doubles  # (N, 3) where they are thought to be in the other file
    reach_m: Doubles  # (N,)
    looks: Doubles  # (N, 6)

    @staticmethod
    def of(splats: Splats, rows: Longs) -> _Cloud:
        means_m, looks = splats.means[rows].astype(np.float64), _looks(splats, rows)
        sizes = (looks[:, :2] * ALIKE[:2]).mean(axis=1)
        return _Cloud(means_m, means_m, REACH * np.exp(np.clip(sizes, -30, 30)), looks)

    def take(self, rows: Longs) -> _Cloud:
        return _Cloud(
            self.means_m[rows], self.guesses_m[rows], self.reach_m[rows], self.looks[rows]
        )


def _mutual(old: _Cloud, new: _Cloud, asking: Longs) -> tuple[Longs, Longs]:
    """Pairs of a row in `asking` of `old` and a row of `new` that are each other's best match."""
    asked = old.take(asking)
    to_new = _best(asked, new, asked.guesses_m, new.means_m, asked.reach_m[:, None])
    rows, to_new = asking[to_new >= 0], to_new[to_new >= 0]
    found = new.take(to_new)
    mutual = _best(found, old, found.means_m, old.guesses_m, old.reach_m) == rows
    return rows[mutual], to_new[mutual]


def _best(
    asking: _Cloud, others: _Cloud, from_m: Doubles, to_m: Doubles, reach_m: Doubles
) -> Longs:
    """(N,) for each of `asking` the best of its nearest among `others`, or -1. reach_m: (N, 1) of
    those that ask, or (M,) of the others."""
    count = min(NEIGHBOURS, len(others.looks))
    distances, found = _nearest(to_m, from_m, count)
    reaches = reach_m if reach_m.ndim == 2 else reach_m[found]
    apart = abs(asking.looks[:, None] - others.looks[found])
    costs = (distances / reaches) ** 2 + (apart**2).sum(axis=2)
    costs[(distances > reaches) | (apart.max(axis=2) > 1)] = np.inf
    best = np.argmin(costs, axis=1)
    rows = np.arange(len(found))
    return np.where(np.isfinite(costs[rows, best]), found[rows, best], -1)


def _nearest(points_m: Doubles, from_m: Doubles, count: int) -> tuple[Doubles, Longs]:
    """(N, count) how far from each of `from_m` the nearest of `points_m` are, and which."""
    from scipy.spatial import cKDTree  # loads slowly, and few commands need it

    distances_m, found = cKDTree(points_m).query(from_m, k=count)
    return distances_m.reshape(-1, count), found.reshape(-1, count)
