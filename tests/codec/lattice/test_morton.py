"""Morton codes against arithmetic on Python integers."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from codec.lattice.morton import BITS_PER_AXIS, interleave

coordinate = st.integers(0, (1 << BITS_PER_AXIS) - 1)


def plain_code(place: tuple[int, ...]) -> int:
    bits = range(BITS_PER_AXIS)
    return sum(((place[axis] >> b) & 1) << (3 * b + axis) for axis in range(3) for b in bits)


@given(st.lists(st.tuples(coordinate, coordinate, coordinate), max_size=20))
def test_interleave_is_the_plain_one(places: list[tuple[int, ...]]) -> None:
    codes = interleave(np.array(places, np.int64).reshape(-1, 3))
    assert codes.tolist() == [plain_code(place) for place in places]
