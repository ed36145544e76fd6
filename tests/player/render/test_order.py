"""The order of visible Gaussians, compared with a stable sort by depth."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from player.render.blend import near_first, radix_sort
from player.render.order import Order
from player.render.upload import NEVER


def test_the_order_is_that_of_a_stable_sort_by_depth() -> None:
    rng = np.random.default_rng(3)
    order = Order(3, 4000)
    for lane in range(3):
        means = rng.normal(size=(3000 + lane, 3)).astype(np.float32) * 10
        means[::7] = means[0]  # ties
        starts = rng.integers(2, 7, 3000 + lane).astype(np.int32)
        order.update_lane(lane, 6 + lane, means, starts)
    w2c = np.eye(4)
    w2c[2, 3] = 1.5
    for frame in range(2, 9):
        depths = (order.means[..., 2] + np.float32(1.5)).ravel()
        shown = (order.starts <= frame) & (order.expires[:, None] > frame)
        shown &= order.expires[:, None] - 3 <= frame
        shown &= np.arange(4000) < order.counts[:, None]
        # Among equal depths the last row of the newest slice is the farthest.
        newest_first = [4000 * ((frame - age) % 3) + np.arange(4000)[::-1] for age in range(3)]
        slots = np.concatenate(newest_first)
        slots = slots[shown.ravel()[slots] & (depths[slots] > 0.5)]
        expected = slots[np.argsort(-depths[slots], kind="stable")]
        np.testing.assert_array_equal(order.far_first(frame, w2c, 0.5), expected)


def test_what_is_kept_goes_on() -> None:
    order = Order(2, 5)
    means = np.zeros((4, 3), np.float32)
    means[:, 2] = 4, 3, 2, 1
    # Shown, late, never shown; the last one is gone with the next slice.
    order.update_lane(0, 2, means, np.array([0, 9, NEVER, 0], np.int32))
    order.update_lane(0, 4, means[:3], np.array([2, 9, NEVER], np.int32))

    def shown(frame: int) -> list[int]:
        return [int(slot) for slot in order.far_first(frame, np.eye(4), 0.5)]

    assert [shown(frame) for frame in (2, 3, 4)] == [[0], [0], []]
    far = np.array([[0, 0, 9]], np.float32)
    order.update_lane(0, 6, far, np.array([5], np.int32), np.array([4], np.int32))
    assert [shown(frame) for frame in (4, 5, 6)] == [[0, 1], [4, 0, 1], []]
    nothing = np.zeros(0, np.int32)
    order.update_lane(0, 8, np.zeros((0, 3), np.float32), nothing, nothing)
    assert [shown(frame) for frame in (6, 7, 8)] == [[4, 0, 1], [4, 0, 1], []]
    # A kept Gaussian started long ago, but after a seek backwards it must not show too early.
    order = Order(2, 1)
    order.update_lane(0, 9, np.array([[0, 0, 4]], np.float32), np.zeros(1, np.int32))
    assert [len(shown(frame)) for frame in (6, 7, 8, 9)] == [0, 1, 1, 0]


depth = st.floats(0, 2.0**90, width=32)


@given(st.lists(st.one_of(depth, st.sampled_from([0.0, 1.5, 2.5])), max_size=60))
def test_any_depths_are_sorted_and_equal_ones_keep_their_order(values: list[float]) -> None:
    depths = np.array(values, np.float32)
    before = depths.copy()
    assert near_first(depths).tolist() == np.argsort(before, kind="stable").tolist()
    np.testing.assert_array_equal(depths, before)
    assert near_first(np.array([-1, 3, 2, -5], np.float32))[:2].tolist() == [2, 1]


@pytest.mark.parametrize("count", [0, 1, 5000])
def test_all_32_bits_count(count: int) -> None:
    keys = np.random.default_rng(count).integers(0, 1 << 32, count, dtype=np.uint32)
    order = np.arange(count, dtype=np.int32)
    expected = np.argsort(keys, kind="stable")
    spare_keys, spare_order = np.empty_like(keys), np.empty_like(order)
    radix_sort(keys.copy(), order, spare_keys, spare_order)
    np.testing.assert_array_equal(spare_order, expected)
    np.testing.assert_array_equal(spare_keys, keys[expected])
