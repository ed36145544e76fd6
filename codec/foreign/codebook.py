"""Codebooks: few values, or few rows of values, that stand for many. The same input always gives
the same book."""

from __future__ import annotations

import numpy as np

from codec.arrays import Bytes, Doubles, Floats, Longs
from codec.kernel import kernel

CODES = 256
MAX_ROUNDS = 60
"""Rounds of Lloyd's iteration, which moves little after twenty."""


def codebook(values: Floats) -> Floats:
    """(256,) ascending values of which the nearest stands for each of `values`.

    What has no more different values is kept exactly. Else Lloyd's iteration (S. Lloyd, "Least
    squares quantization in PCM", 1982) from a start that is half quantiles, where most values lie,
    and half even steps, so that none is far away.
    """
    ordered = np.sort(values.ravel()).astype(np.float64)
    different = ordered[np.flatnonzero(np.diff(ordered, prepend=np.nan) != 0)]
    if len(different) <= CODES:
        last = different[-1:] if len(different) else np.zeros(1)
        return np.append(different, np.repeat(last, CODES - len(different))).astype(np.float32)
    half = (np.arange(CODES // 2) + 0.5) / (CODES // 2)
    even = ordered[0] + half * (ordered[-1] - ordered[0])
    book: Doubles = np.sort(np.append(ordered[(half * len(ordered)).astype(np.int64)], even))
    sums = np.append(0.0, np.cumsum(ordered))
    before = np.empty(0, np.intp)
    for _ in range(MAX_ROUNDS):
        ends = np.searchsorted(ordered, _middles(book))
        if np.array_equal(ends, before):
            break
        before = ends
        bounds = np.concatenate(([0], ends, [len(ordered)]))
        counts = np.diff(bounds)
        book = np.where(counts > 0, np.diff(sums[bounds]) / np.maximum(counts, 1), book)
    return np.sort(book.astype(np.float32))


def _middles(book: Doubles) -> Doubles:
    middles: Doubles = (book[1:] + book[:-1]) / 2
    return middles


def codes_of(values: Floats, book: Floats) -> Bytes:
    """Which of the ascending `book` is nearest to each of `values`; the shape of `values`."""
    codes: Bytes = np.searchsorted(_middles(book.astype(np.float64)), values).astype(np.uint8)
    return codes


@kernel(nogil=True)
def _spread_of(values, labels, counts, means, squares):  # type: ignore[no-untyped-def]
    """Fills counts (k,), means (k, D) and the summed squares around them (k, D), which begin as
    zeros, of the rows with each label."""
    for i in range(values.shape[0]):
        counts[labels[i]] += 1
        for d in range(values.shape[1]):
            means[labels[i], d] += values[i, d]
    for j in range(means.shape[0]):
        for d in range(means.shape[1]):
            means[j, d] /= max(counts[j], 1)
    for i in range(values.shape[0]):
        for d in range(values.shape[1]):
            away = values[i, d] - means[labels[i], d]
            squares[labels[i], d] += away * away


def palette(rows: Floats, size: int) -> tuple[Floats, Longs]:
    """(k, D) rows, k at most `size`, and (N,) which of them stands for each of the (N, D) `rows`.

    A tree: in each round the half of the groups that spread most are cut in two, across the axis on
    which they spread most and at their mean. It takes about log_1.5(size) rounds over all rows,
    where nearest-centre clustering would look at every pair. Groups are numbered by their first
    row. Rows that are alike share a group.
    """
    labels = np.zeros(len(rows), np.int64)
    count = 1
    while True:
        counts = np.zeros(count, np.int64)
        means, squares = np.zeros((2, count, rows.shape[1]))
        _spread_of(rows, labels, counts, means, squares)
        spread = squares.sum(axis=1)
        room = min(size - count, (count + 1) // 2)
        worst = np.argsort(-spread, kind="stable")[:room]
        worst = worst[spread[worst] > 0]
        if not len(worst):
            break
        child = np.full(count, -1)
        child[worst] = count + np.arange(len(worst))
        axis = squares.argmax(axis=1)
        above = rows[np.arange(len(rows)), axis[labels]] > means[labels, axis[labels]]
        labels = np.where(above & (child[labels] >= 0), child[labels], labels)
        count += len(worst)
    used, first = np.unique(labels, return_index=True)
    order = used[np.argsort(first)]
    rank = np.zeros(count, np.int64)
    rank[order] = np.arange(len(order))
    return means[order].astype(np.float32), rank[labels]
