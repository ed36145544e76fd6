"""The Gaussians of a change as byte planes: predicted ones as differences to what they were, new
ones one after another (codec/FORMAT.md, sections 10.1 and 10.2).
"""

from __future__ import annotations

import numpy as np

from codec.arrays import Bytes, Flags, Ints
from codec.errors import CorruptError
from codec.kernel import kernel
from codec.lattice.lattice import POSITION_LIMIT, States, num_attributes

LONG = 255
"""The byte of a difference that stands among the long residuals."""

MAX_LENGTH = 25
"""Bit length of the zigzag of the longest difference of two positions on the lattice."""

SPARE_BYTES = 4
"""Behind the low bits, so that a run of them is read without looking at the end."""


def encode_predicted(before: States, predicted: States) -> tuple[Bytes, Ints]:
    """(3 + A, P) planes of the differences, and those that a byte does not hold."""
    count = len(predicted)
    planes = np.empty((3 + predicted.attributes.shape[1], count), np.uint8)
    longs = np.empty(3 * count, np.int32)
    used = _encode_predicted(
        before.positions,
        before.attributes,
        predicted.positions,
        predicted.attributes,
        planes,
        longs,
    )
    return planes, longs[:used]


def decode_predicted(
    planes: Bytes, longs: Ints, before: States, known: Flags, opacity_levels: int
) -> States:
    """The states that `encode_predicted` took apart; zeros where `before` is not known.

    Raises CorruptError for a wrong number of long residuals and for what leaves the lattice.
    """
    wanted = int(np.count_nonzero(planes[:3] == LONG))
    if wanted != len(longs):
        raise CorruptError(f"change: {len(longs)} long residuals where {wanted} belong")
    made = States(np.empty_like(before.positions), np.empty_like(before.attributes))
    wrong = _decode_predicted(
        planes,
        longs,
        before.positions,
        before.attributes,
        known,
        opacity_levels,
        made.positions,
        made.attributes,
    )
    if wrong >= 0:
        raise CorruptError(f"change: predicted Gaussian {wrong} leaves the lattice")
    return made


def encode_new(new: States, escaped: Flags) -> tuple[Bytes, bytes]:
    """(3 + A, N) planes of Gaussians, and the low bits of their positions. One that escapes takes
    the position of the one before it, and bytes of zero."""
    planes = np.empty((3 + new.attributes.shape[1], len(new)), np.uint8)
    packed = np.zeros((3 * (MAX_LENGTH - 1) * len(new) + 7) // 8 + 1, np.uint8)
    num_bits = _encode_new(new.positions, new.attributes, escaped, planes, packed)
    return planes, packed[: (num_bits + 7) // 8].tobytes()


def decode_new(
    planes: Bytes, low_bits: bytes | memoryview, sh_degree: int, opacity_levels: int
) -> States:
    """The states that `encode_new` took apart.

    Raises CorruptError for a wrong amount of bits, a bit set behind them, and for what is not on
    the lattice.
    """
    count = planes.shape[1]
    lengths = planes[:3]
    if count and lengths.max() > MAX_LENGTH:
        raise CorruptError(f"change: a difference of {lengths.max()} bits, at most {MAX_LENGTH}")
    if count and planes[-1].max() >= opacity_levels:
        raise CorruptError(f"change: opacity {planes[-1].max()} of {opacity_levels} levels")
    num_bits = int(lengths.sum(dtype=np.int64)) - int(np.count_nonzero(lengths))
    if len(low_bits) != (num_bits + 7) // 8:
        raise CorruptError(f"change: {len(low_bits)} bytes of low bits, not {num_bits} bits")
    packed = np.zeros(len(low_bits) + SPARE_BYTES, np.uint8)
    packed[: len(low_bits)] = np.frombuffer(low_bits, np.uint8)
    if num_bits % 8 and packed[len(low_bits) - 1] >> (num_bits % 8):
        raise CorruptError(f"change: a bit is set after the {num_bits} low bits")
    made = States(
        np.empty((count, 3), np.int32), np.empty((count, num_attributes(sh_degree)), np.uint8)
    )
    wrong = _decode_new(planes, packed, made.positions, made.attributes)
    if wrong >= 0:
        raise CorruptError(f"change: new Gaussian {wrong} leaves the lattice")
    return made


@kernel(nogil=True)
def _zigzag(value):  # type: ignore[no-untyped-def]
    return 2 * value if value >= 0 else -2 * value - 1


@kernel(nogil=True)
def _unzigzag(value):  # type: ignore[no-untyped-def]
    return (value >> 1) ^ -(value & 1)


@kernel(nogil=True)
def _encode_predicted(  # type: ignore[no-untyped-def]
    old_positions, old_attributes, positions, attributes, planes, longs
):
    """Fills planes and longs; gives how many are long."""
    used = 0
    for axis in range(3):
        for i in range(positions.shape[0]):
            difference = np.int64(positions[i, axis]) - np.int64(old_positions[i, axis])
            value = _zigzag(difference)
            if value < LONG:
                planes[axis, i] = value
            else:
                planes[axis, i] = LONG
                longs[used] = difference
                used += 1
    for i in range(attributes.shape[0]):
        for a in range(attributes.shape[1]):
            step = (np.int64(attributes[i, a]) - np.int64(old_attributes[i, a])) & 255
            planes[3 + a, i] = _zigzag(step - 256 if step > 127 else step)
    return used


@kernel(nogil=True)
def _decode_predicted(  # type: ignore[no-untyped-def]
    planes, longs, old_positions, old_attributes, known, levels, positions, attributes
):
    """Fills the last two; gives the first that leaves the lattice, or -1."""
    limit, last = POSITION_LIMIT, attributes.shape[1] - 1
    used = 0
    wrong = -1
    for axis in range(3):
        for i in range(positions.shape[0]):
            difference = _unzigzag(np.int64(planes[axis, i]))
            if planes[axis, i] == LONG:
                difference = np.int64(longs[used])
                used += 1
            if known[i]:
                place = np.int64(old_positions[i, axis]) + difference
                if place <= -limit or place >= limit:
                    wrong = i
                    place = 0
                positions[i, axis] = place
            else:
                positions[i, axis] = 0
    for i in range(attributes.shape[0]):
        if not known[i]:
            for a in range(last + 1):
                attributes[i, a] = 0
            continue
        for a in range(last + 1):
            step = _unzigzag(np.int64(planes[3 + a, i]))
            attributes[i, a] = (np.int64(old_attributes[i, a]) + step) & 255
        if attributes[i, last] >= levels:
            wrong = i
    return wrong


@kernel(nogil=True)
def _encode_new(positions, attributes, escaped, planes, packed):  # type: ignore[no-untyped-def]
    """Fills planes and packed, which begins as zeros; gives the number of low bits."""
    last = attributes.shape[1] - 1
    before = np.zeros(3, np.int64)
    bit = 0
    for i in range(positions.shape[0]):
        if escaped[i]:
            for plane in range(planes.shape[0]):
                planes[plane, i] = 0
            continue
        for axis in range(3):
            place = np.int64(positions[i, axis])
            value = _zigzag(place - before[axis])
            before[axis] = place
            length = 0
            while value >> length:
                length += 1
            planes[axis, i] = length
            left = length - 1
            while left > 0:
                taken = min(8 - (bit & 7), left)
                packed[bit >> 3] |= (value & ((1 << taken) - 1)) << (bit & 7)
                value >>= taken
                left -= taken
                bit += taken
        for a in range(last):
            planes[3 + a, i] = attributes[i, a] ^ 128
        planes[3 + last, i] = attributes[i, last]
    return bit


@kernel(nogil=True)
def _decode_new(planes, packed, positions, attributes):  # type: ignore[no-untyped-def]
    """Fills the last two; gives the first that leaves the lattice, or -1. packed: the low bits and
    SPARE_BYTES more."""
    limit, last = POSITION_LIMIT, attributes.shape[1] - 1
    before = np.zeros(3, np.int64)
    bit = np.int64(0)
    for i in range(positions.shape[0]):
        for axis in range(3):
            length = np.int64(planes[axis, i])
            if length > 0:
                first = bit >> 3
                word = np.int64(0)
                for byte in range(4):
                    word |= np.int64(packed[first + byte]) << (8 * byte)
                leading = 1 << (length - 1)
                value = leading | ((word >> (bit & 7)) & (leading - 1))
                bit += length - 1
                before[axis] += _unzigzag(value)
            if before[axis] <= -limit or before[axis] >= limit:
                return i
            positions[i, axis] = before[axis]
    for i in range(attributes.shape[0]):
        for a in range(last):
            attributes[i, a] = planes[3 + a, i] ^ 128
        attributes[i, last] = planes[3 + last, i]
    return -1
