"""Layers: a split and a merge lose nothing, and the important come first."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from codec.errors import CorruptError, InvalidError
from codec.profiles.profile import Profile
from codec.slice import Slice
from codec.stream.chunk import Chunk
from codec.stream.layers import (
    RANKS,
    Rank,
    check_shares,
    merge_layers,
    opacity_rank,
    split_layers,
)
from tests.support.trained_like import trained_like_slice

QUARTERS = (0.25, 0.25, 0.25, 0.25)


def chunks(slice: Slice, shares: tuple[float, ...] = QUARTERS) -> list[Chunk]:
    layers = split_layers(slice, shares, opacity_rank)
    return [Chunk(slice.birth, n, Profile.RAW, layer) for n, layer in enumerate(layers)]


def rows(slice: Slice) -> list[bytes]:
    """Each Gaussian as bytes, its start offset with it."""
    s = slice.splats
    columns = (s.means, s.log_scales, s.quats, s.logit_opacities[:, None], s.sh[:, 0])
    table = np.concatenate([*columns, slice.start_offsets[:, None]], axis=1)
    return [row.tobytes() for row in table.astype(np.float64)]


@given(st.integers(0, 200), st.lists(st.integers(1, 9), min_size=1, max_size=16))
@settings(max_examples=60, deadline=None)
def test_merge_of_split_is_a_permutation(count: int, weights: list[int]) -> None:
    slice = trained_like_slice(5, count)
    shares = tuple(weight / sum(weights) for weight in weights)
    parts = chunks(slice, shares)
    assert sorted(rows(merge_layers(parts))) == sorted(rows(slice))
    for part, share in zip(parts, shares, strict=True):
        assert abs(len(part.slice.splats) - share * count) <= 1


def test_every_rank_has_its_function() -> None:
    assert list(RANKS) == list(Rank)


@pytest.mark.parametrize("rank", list(Rank))
def test_an_earlier_layer_ranks_higher(rank: Rank) -> None:
    slice = trained_like_slice(0, 1000)
    layers = split_layers(slice, QUARTERS, RANKS[rank])
    rank_of = dict(zip(rows(slice), RANKS[rank](slice.splats).tolist(), strict=True))
    ranks = [[rank_of[row] for row in rows(layer)] for layer in layers]
    for high, low in pairwise(ranks):
        assert min(high) >= max(low)


def test_rank_given_cuts_the_slice_as_it_stands() -> None:
    slice = trained_like_slice(0, 1000)
    layers = split_layers(slice, QUARTERS, RANKS[Rank.GIVEN])
    assert [row for layer in layers for row in rows(layer)] == rows(slice)
    assert [len(layer.splats) for layer in layers] == [250] * 4


def test_equal_ranks_keep_their_order() -> None:
    slice = trained_like_slice(0, 20)
    layers = split_layers(slice, (0.5, 0.5), lambda splats: np.zeros(len(splats), np.float32))
    assert rows(layers[0]) + rows(layers[1]) == rows(slice)


def test_what_does_not_belong_together_is_refused() -> None:
    ours, others = chunks(trained_like_slice(1, 40)), chunks(trained_like_slice(2, 40))
    assert len(merge_layers(ours[:2]).splats) == 20
    for wrong in ([], ours[1:], [ours[0], ours[2]], [ours[0], others[1]], [ours[0], ours[0]]):
        with pytest.raises(CorruptError):
            merge_layers(wrong)
    degree_1 = chunks(trained_like_slice(1, 40, sh_degree=1))
    with pytest.raises(CorruptError, match="SH degree"):
        merge_layers([ours[0], degree_1[1]])


@pytest.mark.parametrize("shares", [(), (0.5,), (0.5, 0.6), (1.5, -0.5), (1 / 17,) * 17])
def test_shares_that_do_not_make_a_whole(shares: tuple[float, ...]) -> None:
    with pytest.raises(InvalidError):
        check_shares(shares)
