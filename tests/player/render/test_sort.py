"""The sort by depth, compared with numpy's stable sort."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from player.render.sort import near_first, radix_sort

depth = st.floats(0, 2.0**90, width=32)


@given(st.lists(st.one_of(depth, st.sampled_from([0.0, 1.5, 2.5])), max_size=60))
def test_ascending_and_equal_depths_keep_their_order(values: list[float]) -> None:
    depths = np.array(values, np.float32)
    before = depths.copy()
    assert near_first(depths).tolist() == np.argsort(before, kind="stable").tolist()
    np.testing.assert_array_equal(depths, before)


@pytest.mark.parametrize("count", [0, 1, 5000])
def test_all_32_bits_count(count: int) -> None:
    keys = np.random.default_rng(count).integers(0, 1 << 32, count, dtype=np.uint32)
    order = np.arange(count, dtype=np.int32)
    expected = np.argsort(keys, kind="stable")
    spare_keys, spare_order = np.empty_like(keys), np.empty_like(order)
    radix_sort(keys.copy(), order, spare_keys, spare_order)
    np.testing.assert_array_equal(spare_order, expected)
    np.testing.assert_array_equal(spare_keys, keys[expected])


def test_what_lies_behind_the_camera_comes_last() -> None:
    assert near_first(np.array([-1, 3, 2, -5], np.float32))[:2].tolist() == [2, 1]
