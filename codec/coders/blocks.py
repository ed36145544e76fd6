"""Where the blocks of a packet end, each of which has a Huffman table of its own.

A chunk is a row of planes with different statistics, so an encoder ends a block where a new table
pays; a decoder need not know.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import numpy as np

MAX_JOINED_PLANES = 8
"""Planes tried in one block; bounds the work for chunks with many SH planes."""

Table = tuple[float, float]
"""Estimated size of the Huffman table of a block in bytes: a fixed part, and one for each byte
value up to the largest in the block."""

TABLE: Table = 12.0, 0.25

TABLES: tuple[Table, ...] = TABLE, (16.0, 0.15), (8.0, 0.25), (12.0, 0.1)
"""Estimates to try where bytes matter more than time: each is the best one for some chunks."""


def join_planes(content: memoryview, edges: Sequence[int], table: Table = TABLE) -> list[int]:
    """Those of `edges` where blocks should end to cost least, by their entropy and their tables."""
    planes = [
        np.bincount(np.frombuffer(content[a:b], np.uint8), minlength=256)
        for a, b in pairwise(edges)
    ]
    totals = np.concatenate([np.zeros((1, 256), np.int64), np.cumsum(planes, axis=0)])
    cost = [0.0]
    origin = [0]
    for end in range(1, len(edges)):
        starts = np.arange(max(0, end - MAX_JOINED_PLANES), end)
        counts = (totals[end] - totals[starts]).astype(np.float64)
        sizes = counts.sum(axis=1)
        with np.errstate(divide="ignore", invalid="ignore"):
            bits = np.where(counts > 0, -counts * np.log2(counts / sizes[:, None]), 0).sum(axis=1)
        last_value = 256 - np.argmax(counts[:, ::-1] > 0, axis=1)
        coded = bits / 8 + table[0] + table[1] * last_value
        total = np.minimum(coded, sizes + 3) + [cost[start] for start in starts]
        best = int(np.argmin(total))
        cost.append(float(total[best]))
        origin.append(int(starts[best]))
    chosen = [len(edges) - 1]
    while chosen[-1]:
        chosen.append(origin[chosen[-1]])
    return [edges[i] for i in reversed(chosen)]
