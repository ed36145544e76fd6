"""Where the blocks of a packet end, each of which has a Huffman table of its own, and how much time
a coder takes to find out.

A chunk is a row of planes with different statistics, so an encoder ends a block where a new table
pays; a decoder need not know.
"""

from __future__ import annotations

from collections.abc import Sequence
from enum import Enum, auto

import numpy as np

from codec.arrays import Longs
from codec.kernel import kernel


class Effort(Enum):
    """A trade of an encoder's time against bytes."""

    QUICK = auto()
    """For a live stream, whose viewers wait; see QUICK_LEVEL."""
    USUAL = auto()
    MOST = auto()
    """Tries several ways to divide a chunk into blocks, and keeps the smallest packet."""


MAX_JOINED_PLANES = 8
"""Planes tried in one block; bounds the work for chunks with many SH planes."""

Table = tuple[float, float]
"""Estimated size of the Huffman table of a block in bytes: a fixed part, and one for each byte
value up to the largest in the block."""

TABLE: Table = 12.0, 0.25

TABLES: tuple[Table, ...] = TABLE, (16.0, 0.15), (8.0, 0.25), (12.0, 0.1)
"""The estimates of Effort.MOST: each is the best one for some chunks."""


def divisions(
    content: memoryview, edges: Sequence[int], effort: Effort = Effort.USUAL
) -> list[tuple[int, ...]]:
    """The offsets, from 0 to the end, between blocks of `content`: those of its plane `edges` at
    which blocks should end to cost least, by their entropy and their tables. Effort.MOST gives
    several such divisions to try."""
    edges = sorted(set(edges))
    totals = np.zeros((len(edges), 256), np.int64)
    _count(np.frombuffer(content, np.uint8), np.array(edges), totals)
    tables = TABLES if effort is Effort.MOST else (TABLE,)
    return list(dict.fromkeys(_cheapest_division(totals, edges, table) for table in tables))


def _cheapest_division(totals: Longs, edges: Sequence[int], table: Table) -> tuple[int, ...]:
    origin = np.zeros(len(edges), np.int64)
    _cheapest(totals, MAX_JOINED_PLANES, *table, origin)
    chosen = [len(edges) - 1]
    while chosen[-1]:
        chosen.append(int(origin[chosen[-1]]))
    return tuple(edges[i] for i in reversed(chosen))


@kernel(nogil=True)
def _count(content, edges, totals):  # type: ignore[no-untyped-def]
    """Fills totals, zeros: how often each byte occurs before an edge."""
    for end in range(1, edges.shape[0]):
        totals[end] = totals[end - 1]
        for at in range(edges[end - 1], edges[end]):
            totals[end, content[at]] += 1


@kernel(nogil=True)
def _cheapest(totals, most_planes, table_bytes, bytes_per_value, origin):  # type: ignore[no-untyped-def]
    """Fills origin: where the block that ends at each edge should begin. totals: (E, 256) how often
    each byte occurs before an edge."""
    cost = np.zeros(totals.shape[0])
    for end in range(1, totals.shape[0]):
        best = np.inf
        for start in range(max(0, end - most_planes), end):
            size = 0
            last_value = 0
            for value in range(256):
                count = totals[end, value] - totals[start, value]
                if count > 0:
                    size += count
                    last_value = value
            bits = 0.0
            for value in range(last_value + 1):
                count = totals[end, value] - totals[start, value]
                if count > 0:
                    bits -= count * np.log2(count / size)
            coded = bits / 8 + table_bytes + bytes_per_value * (last_value + 1 if size else 256)
            total = cost[start] + min(coded, size + 3.0)
            if total < best:
                best = total
                origin[end] = start
        cost[end] = best
