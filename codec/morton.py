"""Integer positions as a sorted list of Morton codes, and that list as gaps.

Where Gaussians may be permuted freely, N sorted codes cost log2(N!) bits less than N positions,
and empty space costs next to nothing. A gap is split into its bit length, which has few likely
values and is worth entropy coding, and the bits under its leading one, which are noise and packed
as they are.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from .errors import CorruptError

BITS_PER_AXIS = 20
"""Bits of an integer coordinate: two halves of 30 bits suit a decoder without 64-bit integers."""

CODE_BITS = 3 * BITS_PER_AXIS

Codes = npt.NDArray[np.uint64]

# Each step doubles the distance between groups of bits: 20 together, then 16 + 4, 8, 4, 2, 1.
_SPREAD = (
    (32, 0x000F00000000FFFF),
    (16, 0x000F0000FF0000FF),
    (8, 0xF00F00F00F00F00F),
    (4, 0x30C30C30C30C30C3),
    (2, 0x9249249249249249),
)
_AXIS_MASK = (1 << BITS_PER_AXIS) - 1


def _spread(values: Codes) -> Codes:
    """Bit b of each value moved to bit 3 b."""
    for shift, mask in _SPREAD:
        values = (values | (values << np.uint64(shift))) & np.uint64(mask)
    return values


def _gather(codes: Codes) -> Codes:
    """Bit 3 b of each code moved to bit b."""
    codes = codes & np.uint64(_SPREAD[-1][1])
    masks = [mask for _, mask in _SPREAD[-2::-1]] + [_AXIS_MASK]
    for (shift, _), mask in zip(_SPREAD[::-1], masks, strict=True):
        codes = (codes | (codes >> np.uint64(shift))) & np.uint64(mask)
    return codes


def interleave(coordinates: npt.NDArray[np.int64]) -> Codes:
    """(N,) Morton codes of (N, 3) coordinates below 2**BITS_PER_AXIS; bit 0 of x is the lowest."""
    x, y, z = (_spread(axis.astype(np.uint64)) for axis in coordinates.T)
    codes: Codes = x | (y << np.uint64(1)) | (z << np.uint64(2))
    return codes


def deinterleave(codes: Codes) -> npt.NDArray[np.int64]:
    """(N, 3) coordinates of (N,) Morton codes."""
    axes = [_gather(codes >> np.uint64(axis)) for axis in range(3)]
    return np.stack(axes, axis=1).astype(np.int64)


def _bit_lengths(values: Codes) -> npt.NDArray[np.uint8]:
    lengths = np.zeros(len(values), np.uint8)
    for shift in (32, 16, 8, 4, 2, 1):
        large = (values >> np.uint64(shift)) > 0
        lengths[large] += np.uint8(shift)
        values = np.where(large, values >> np.uint64(shift), values)
    lengths += values > 0
    return lengths


def encode_gaps(codes: Codes) -> tuple[npt.NDArray[np.uint8], bytes]:
    """(N,) bit lengths of the gaps between sorted `codes`, the first from 0, and their low bits.

    The low bits are one bit string: for each gap the bits under its leading one, lowest first; the
    string fills bytes from their lowest bit, and the last byte is filled up with zeros.
    """
    gaps = np.diff(codes, prepend=np.uint64(0))
    lengths = _bit_lengths(gaps)
    first, shift, num_bits = _places(lengths)
    leading = (np.uint64(1) << lengths.astype(np.uint64)) >> np.uint64(1)
    low = gaps ^ leading
    # A run of up to 59 bits from bit 0..7 of its first byte reaches into 9 bytes.
    pieces = [(low << shift) >> np.uint64(8 * byte) & np.uint64(255) for byte in range(8)]
    # Two shifts, because a shift by 64 is not defined.
    pieces.append((low >> np.uint64(1)) >> (np.uint64(63) - shift))
    packed = np.zeros((num_bits + 7) // 8 + 9)
    for byte, piece in enumerate(pieces):
        # No bit is shared, so a sum is an or; float64 holds it exactly.
        packed += np.bincount(first + byte, weights=piece, minlength=len(packed))
    return lengths, packed[: (num_bits + 7) // 8].astype(np.uint8).tobytes()


def _places(lengths: npt.NDArray[np.uint8]) -> tuple[npt.NDArray[np.int64], Codes, int]:
    """First byte and bit in it of the low bits of each gap, and the number of all bits."""
    widths = np.maximum(lengths.astype(np.int64) - 1, 0)
    ends = np.cumsum(widths)
    starts = ends - widths
    return starts >> 3, (starts & 7).astype(np.uint64), int(ends[-1]) if len(ends) else 0


def decode_gaps(lengths: npt.NDArray[np.uint8], low_bits: bytes | memoryview) -> Codes:
    """The sorted codes that `encode_gaps` took apart.

    Raises CorruptError for a wrong amount of bits, or a code over CODE_BITS bits.
    """
    if len(lengths) and lengths.max() > CODE_BITS:
        raise CorruptError(f"positions: a gap of {lengths.max()} bits, at most {CODE_BITS}")
    first, shift, num_bits = _places(lengths)
    if len(low_bits) != (num_bits + 7) // 8:
        raise CorruptError(f"positions: {len(low_bits)} bytes of low bits, not {num_bits} bits")
    packed = np.zeros(len(low_bits) + 9, np.uint8)
    packed[: len(low_bits)] = np.frombuffer(low_bits, np.uint8)
    words = np.zeros(len(lengths), np.uint64)
    for byte in range(8):
        words |= packed[first + byte].astype(np.uint64) << np.uint64(8 * byte)
    last = packed[first + 8].astype(np.uint64)
    values = (words >> shift) | ((last << np.uint64(1)) << (np.uint64(63) - shift))
    leading = (np.uint64(1) << lengths.astype(np.uint64)) >> np.uint64(1)
    gaps = np.where(lengths > 0, leading | (values & (leading - np.uint64(1))), np.uint64(0))
    codes: Codes = np.cumsum(gaps, dtype=np.uint64)
    # A sum cannot jump over this range, for every gap is below 2**CODE_BITS.
    if (codes >> np.uint64(CODE_BITS)).any():
        raise CorruptError(f"positions: a code of more than {CODE_BITS} bits")
    return codes
