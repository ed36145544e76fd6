"""Layers: a split loses nothing, fits the slots, and has important Gaussians first."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from codec.stream.layers import RANKS, Rank, layer_counts, opacity_rank, split_layers
from tests.support.trained_like import trained_like_splats

QUARTERS = (250,) * 4


@given(st.lists(st.integers(1, 1000), min_size=1, max_size=16), st.data())
def test_layers_are_about_equally_full(slots: list[int], data: st.DataObject) -> None:
    count = data.draw(st.integers(0, sum(slots)))
    counts = layer_counts(count, slots)
    assert sum(counts) == count
    for taken, most in zip(counts, slots, strict=True):
        assert 0 <= taken <= most
        assert abs(taken - count * most / sum(slots)) <= 1


def test_the_largest_slices_fit() -> None:
    for slots in ((1, (1 << 20) - 1), (1,) * 15 + ((1 << 20) - 15,), (349_525,) * 3):
        assert layer_counts(sum(slots), slots) == slots
        for count in (1, sum(slots) // 2, sum(slots) - 1):
            pairs = zip(layer_counts(count, slots), slots, strict=True)
            assert all(taken <= most for taken, most in pairs)


@given(st.integers(0, 200), st.lists(st.integers(1, 90), min_size=1, max_size=16))
def test_a_split_holds_every_row_once_in_order(count: int, slots: list[int]) -> None:
    count = min(count, sum(slots))
    layers = split_layers(trained_like_splats(count), slots, opacity_rank)
    assert tuple(map(len, layers)) == layer_counts(count, slots)
    assert sorted(np.concatenate(layers).tolist()) == list(range(count))
    assert all((np.diff(rows) > 0).all() for rows in layers)


@pytest.mark.parametrize("rank", list(Rank))
def test_an_earlier_layer_ranks_higher(rank: Rank) -> None:
    splats = trained_like_splats(1000)
    ranks = RANKS[rank](splats)
    for high, low in pairwise(split_layers(splats, QUARTERS, RANKS[rank])):
        assert ranks[high].min() >= ranks[low].max()
    assert list(RANKS) == list(Rank)
    for same in (RANKS[Rank.GIVEN], lambda splats: np.zeros(len(splats), np.float32)):
        layers = split_layers(splats, QUARTERS, same)
        assert np.concatenate(layers).tolist() == list(range(1000))
