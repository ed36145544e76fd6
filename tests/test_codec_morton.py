"""Morton codes and gaps against arithmetic on Python integers."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from codec.errors import CorruptError
from codec.morton import BITS_PER_AXIS, decode_gaps, encode_gaps, gather, interleave

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
    ("lengths", "low_bits"),
    [
        ([61], bytes(8)),
        ([255], bytes(32)),
        ([9], b""),
        ([9], bytes(2)),
        ([60, 60, 60], bytes(23)),
        ([60] * 64, bytes([255]) * (59 * 8)),
    ],
)
def test_gaps_that_no_encoder_made(lengths: list[int], low_bits: bytes) -> None:
    with pytest.raises(CorruptError):
        decode_gaps(np.array(lengths, np.uint8), low_bits)
