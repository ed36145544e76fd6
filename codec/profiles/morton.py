"""Integer positions as a sorted list of Morton codes, and that list as gaps.

Where Gaussians may be permuted freely, N sorted codes cost log2(N!) bits less than N positions,
and empty space costs next to nothing. A gap is split into its bit length, which has few likely
values and is worth entropy coding, and the bits under its leading one, which are noise and packed
as they are.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from codec.errors import CorruptError
from codec.kernel import kernel

BITS_PER_AXIS = 20
"""Bits of an integer coordinate: two halves of 30 bits suit a decoder without 64-bit integers."""

CODE_BITS = 3 * BITS_PER_AXIS

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
def gather(code):  # type: ignore[no-untyped-def]
    """Bit 3 b of a uint64 moved to bit b: an axis of a Morton code shifted down by the axis."""
    code &= np.uint64(0x9249249249249249)
    code = (code | (code >> np.uint64(2))) & np.uint64(0x30C30C30C30C30C3)
    code = (code | (code >> np.uint64(4))) & np.uint64(0xF00F00F00F00F00F)
    code = (code | (code >> np.uint64(8))) & np.uint64(0x000F0000FF0000FF)
    code = (code | (code >> np.uint64(16))) & np.uint64(0x000F00000000FFFF)
    return (code | (code >> np.uint64(32))) & np.uint64((1 << BITS_PER_AXIS) - 1)


@kernel(nogil=True)
def _interleave(coordinates, codes):  # type: ignore[no-untyped-def]
    for i in range(codes.shape[0]):
        x = _spread(np.uint64(coordinates[i, 0]))
        y = _spread(np.uint64(coordinates[i, 1]))
        z = _spread(np.uint64(coordinates[i, 2]))
        codes[i] = x | (y << np.uint64(1)) | (z << np.uint64(2))


def interleave(coordinates: npt.NDArray[np.int64]) -> Codes:
    """(N,) Morton codes of (N, 3) coordinates below 2**BITS_PER_AXIS; bit 0 of x is the lowest."""
    codes = np.empty(len(coordinates), np.uint64)
    _interleave(coordinates, codes)
    return codes


@kernel(nogil=True)
def _encode_gaps(codes, lengths, packed):  # type: ignore[no-untyped-def]
    """Fills lengths and packed, which begins as zeros; gives the number of low bits."""
    before = np.uint64(0)
    bit = 0
    for i in range(codes.shape[0]):
        gap = codes[i] - before
        before = codes[i]
        length = 0
        while length < 64 and gap >> np.uint64(length):
            length += 1
        lengths[i] = length
        left = length - 1
        while left > 0:
            free = 8 - (bit & 7)
            taken = min(free, left)
            part = gap & np.uint64((1 << taken) - 1)
            packed[bit >> 3] |= np.uint8(part << np.uint64(bit & 7))
            gap >>= np.uint64(taken)
            left -= taken
            bit += taken
    return bit


def encode_gaps(codes: Codes) -> tuple[npt.NDArray[np.uint8], bytes]:
    """(N,) bit lengths of the gaps between sorted `codes`, the first from 0, and their low bits.

    The low bits are one bit string: for each gap the bits under its leading one, lowest first; the
    string fills bytes from their lowest bit, and the last byte is filled up with zeros.
    """
    lengths = np.empty(len(codes), np.uint8)
    packed = np.zeros((len(codes) * (CODE_BITS - 1) + 7) // 8, np.uint8)
    num_bits = _encode_gaps(codes, lengths, packed)
    return lengths, packed[: (num_bits + 7) // 8].tobytes()


@kernel(nogil=True)
def _decode_gaps(lengths, packed, codes):  # type: ignore[no-untyped-def]
    """Fills codes; whether all of them fit. packed: the low bits and 9 bytes more."""
    code = np.uint64(0)
    bit = 0
    for i in range(lengths.shape[0]):
        if lengths[i] > 0:
            width = int(lengths[i]) - 1
            first = bit >> 3
            word = np.uint64(0)
            for byte in range(8):
                word |= np.uint64(packed[first + byte]) << np.uint64(8 * byte)
            # A run of up to 59 bits from bit 0..7 of its first byte reaches into 9 bytes. Two
            # shifts, because a shift by 64 is not defined.
            shift = np.uint64(bit & 7)
            last = np.uint64(packed[first + 8]) << np.uint64(1)
            low = (word >> shift) | (last << (np.uint64(63) - shift))
            leading = np.uint64(1) << np.uint64(width)
            code += leading | (low & (leading - np.uint64(1)))
            bit += width
        # Seen before the sum can wrap around, because every gap is below 2**CODE_BITS.
        if code >> np.uint64(CODE_BITS):
            return False
        codes[i] = code
    return True


def decode_gaps(lengths: npt.NDArray[np.uint8], low_bits: bytes | memoryview) -> Codes:
    """The sorted codes that `encode_gaps` took apart.

    Raises CorruptError for a wrong amount of bits, a bit set behind them, or a code over CODE_BITS
    bits.
    """
    if len(lengths) and lengths.max() > CODE_BITS:
        raise CorruptError(f"positions: a gap of {lengths.max()} bits, at most {CODE_BITS}")
    num_bits = int(lengths.sum(dtype=np.int64)) - int(np.count_nonzero(lengths))
    if len(low_bits) != (num_bits + 7) // 8:
        raise CorruptError(f"positions: {len(low_bits)} bytes of low bits, not {num_bits} bits")
    packed = np.zeros(len(low_bits) + 9, np.uint8)
    packed[: len(low_bits)] = np.frombuffer(low_bits, np.uint8)
    if num_bits % 8 and packed[len(low_bits) - 1] >> (num_bits % 8):
        raise CorruptError(f"positions: a bit is set after the {num_bits} low bits")
    codes = np.empty(len(lengths), np.uint64)
    if not _decode_gaps(lengths, packed, codes):
        raise CorruptError(f"positions: a code of more than {CODE_BITS} bits")
    return codes
