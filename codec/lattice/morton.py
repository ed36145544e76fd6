"""Integer positions along the Morton curve, which keeps neighbours in space together."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from codec.arrays import Longs
from codec.kernel import kernel

BITS_PER_AXIS = 20
"""Bits of an integer coordinate."""

Codes = npt.NDArray[np.uint64]


@kernel(nogil=True)
def _spread(value):  # type: ignore[no-untyped-def]
    """Bit b of a value below 2**BITS_PER_AXIS moved to bit 3 b."""
    # Each step doubles the distance between groups of bits: 16 + 4, then 8, 4, 2, 1.
    value = (value | (value << np.uint64(32))) & np.uint64(0x000F00000000FFFF)
    value = (value | (value << np.uint64(16))) & np.uint64(0x000F0000FF0000FF)
    value = (value | (value << np.uint64(8))) & np.uint64(0xF00F00F00F00F00F)
    value = (value | (value << np.uint64(4))) & np.uint64(0x30C30C30C30C30C3)
    return (value | (value << np.uint64(2))) & np.uint64(0x9249249249249249)


@kernel(nogil=True)
def _interleave(coordinates, codes):  # type: ignore[no-untyped-def]
    for i in range(codes.shape[0]):
        x = _spread(np.uint64(coordinates[i, 0]))
        y = _spread(np.uint64(coordinates[i, 1]))
        z = _spread(np.uint64(coordinates[i, 2]))
        codes[i] = x | (y << np.uint64(1)) | (z << np.uint64(2))


def interleave(coordinates: Longs) -> Codes:
    """(N,) Morton codes of (N, 3) coordinates below 2**BITS_PER_AXIS; bit 0 of x is the lowest."""
    codes = np.empty(len(coordinates), np.uint64)
    _interleave(coordinates, codes)
    return codes
