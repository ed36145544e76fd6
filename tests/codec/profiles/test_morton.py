"""Morton codes and gaps against arithmetic on Python integers."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from codec.errors import CorruptError
from codec.profiles.morton import BITS_PER_AXIS, decode_gaps, encode_gaps, gather, interleave

coordinate = st.integers(0, (1 << BITS_PER_AXIS) - 1)
code = st.integers(0, (1 << 60) - 1)


def plain_code(place: tuple[int, ...]) -> int:
    bits = range(BITS_PER_AXIS)
    return sum(((place[axis] >> b) & 1) << (3 * b + axis) for axis in range(3) for b in bits)


@given(st.lists(st.tuples(coordinate, coordinate, coordinate), max_size=20))
def test_interleave_is_the_plain_one_and_has_an_inverse(places: list[tuple[int, ...]]) -> None:
    array = np.array(places, np.int64).reshape(-1, 3)
    codes = interleave(array)
    assert codes.tolist() == [plain_code(place) for place in places]
    for code, place in zip(codes, places, strict=True):
        assert tuple(gather(code >> np.uint64(axis)) for axis in range(3)) == place


@given(st.lists(code, max_size=50))
@settings(max_examples=200)
def test_gaps_round_trip_and_pack_as_the_format_says(values: list[int]) -> None:
    codes = np.array(sorted(values), np.uint64)
    lengths, low_bits = encode_gaps(codes)
    assert (decode_gaps(lengths, low_bits) == codes).all()
    string, used, before = 0, 0, 0
    for value, length in zip(sorted(values), lengths.tolist(), strict=True):
        gap, before = value - before, value
        assert length == gap.bit_length()
        if gap:
            string |= (gap ^ (1 << (length - 1))) << used
            used += length - 1
    assert low_bits == string.to_bytes((used + 7) // 8, "little")


@pytest.mark.parametrize(
    ("lengths", "low_bits", "message"),
    [
        ([61], bytes(8), "a gap of 61 bits"),
        ([255], bytes(32), "a gap of 255 bits"),
        ([9], b"", "0 bytes of low bits, not 8 bits"),
        ([9], bytes(2), "2 bytes of low bits, not 8 bits"),
        ([1, 0], bytes(1), "1 bytes of low bits, not 0 bits"),
        ([60, 60, 60], bytes(23), "a code of more than 60 bits"),
        ([60] * 64, bytes([255]) * (59 * 8), "a code of more than 60 bits"),
        ([3], b"\xff", "a bit is set after the 2 low bits"),
        ([3], b"\x04", "a bit is set after the 2 low bits"),
        ([9, 0, 2], b"\xff\x80", "a bit is set after the 9 low bits"),
    ],
)
def test_gaps_that_no_encoder_made(lengths: list[int], low_bits: bytes, message: str) -> None:
    with pytest.raises(CorruptError, match=message):
        decode_gaps(np.array(lengths, np.uint8), low_bits)


def test_a_last_byte_that_is_used_to_its_end() -> None:
    assert decode_gaps(np.array([3], np.uint8), b"\x03").tolist() == [7]
    assert decode_gaps(np.array([9], np.uint8), b"\xff").tolist() == [511]
    assert decode_gaps(np.array([1, 0, 1], np.uint8), b"").tolist() == [1, 1, 2]
