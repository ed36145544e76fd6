"""Sorting by depth: a stable radix sort, so equal depths have the same order on every machine."""

from __future__ import annotations

import numpy as np

from codec.arrays import Floats, Ints
from codec.kernel import kernel


@kernel(nogil=True)
def radix_sort(keys, values, spare_keys, spare_values):  # type: ignore[no-untyped-def]
    """Sorts uint32 keys, and values with them, in ascending order, in three passes of 11 bits.

    The result is in the spare arrays; the others are overwritten. The bits of positive floats
    grow with their value, so their view as uint32 is an exact key.
    """
    counts = np.zeros((3, 2048), np.int32)
    for i in range(keys.shape[0]):
        key = keys[i]
        counts[0, key & 2047] += 1
        counts[1, (key >> 11) & 2047] += 1
        counts[2, key >> 22] += 1
    for digit in range(3):
        total = 0
        for value in range(2048):
            count = counts[digit, value]
            counts[digit, value] = total
            total += count
    for digit in range(3):
        shift = 11 * digit
        for i in range(keys.shape[0]):
            place = (keys[i] >> shift) & 2047
            to = counts[digit, place]
            counts[digit, place] = to + 1
            spare_keys[to] = keys[i]
            spare_values[to] = values[i]
        keys, spare_keys = spare_keys, keys
        values, spare_values = spare_values, values


def near_first(depths: Floats) -> Ints:
    """(M,) int32: the order of ascending depths (M,) float32; those below zero come last."""
    keys, order = depths.view(np.uint32).copy(), np.arange(len(depths), dtype=np.int32)
    spare_keys, spare_order = np.empty_like(keys), np.empty_like(order)
    radix_sort(keys, order, spare_keys, spare_order)
    return spare_order
