"""Matching: which Gaussian continues as which one of the next file."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from codec.sequence.matching import match, row_keys
from codec.splats import Splats
from tests.support.deforming import Deforming
from tests.support.drawn import drawn_splats
from tests.support.slots.rotating import figure, turned
from tests.support.trained_like import trained_like_splats


@settings(max_examples=60, deadline=None)
@given(splats=drawn_splats(max_count=12), seed=st.integers(0, 1 << 32))
def test_the_same_bits_go_on_in_any_order(splats: Splats, seed: int) -> None:
    """The match also holds with duplicates, births and deaths."""
    rng = np.random.default_rng(seed)
    rows = rng.integers(0, max(len(splats), 1), len(splats)) if len(splats) else np.zeros(0, int)
    before = splats.take(rows)  # some Gaussians occur twice
    order = rng.permutation(len(before))[: rng.integers(0, len(before) + 1)]
    after = before.take(order)
    continued, same = match(before, after)
    assert same.all()
    for array, earlier in zip(after.arrays, before.arrays, strict=True):
        assert (array == earlier[continued]).all()
    assert len(np.unique(continued)) == len(continued)


@settings(max_examples=60, deadline=None)
@given(a=drawn_splats(max_degree=0, position=1), b=drawn_splats(max_degree=0, position=1))
def test_pairs_are_pairs_whatever_the_files(a: Splats, b: Splats) -> None:
    continued, same = match(a, b)
    assert continued.shape == same.shape == (len(b),)
    used = continued[continued >= 0]
    assert len(np.unique(used)) == len(used)
    assert ((continued >= -1) & (continued < len(a))).all()
    again, _ = match(a, b)
    assert (again == continued).all()


def test_keys_tell_bits_apart() -> None:
    splats = trained_like_splats(5000, sh_degree=1)
    assert len(np.unique(row_keys(splats))) == 5000
    other = splats.sh.copy()
    other[7, 3, 2] = np.nextafter(other[7, 3, 2], np.float32(9))
    changed = Splats(*splats.arrays[:4], other)
    assert np.flatnonzero(row_keys(changed) != row_keys(splats)).tolist() == [7]


def test_colours_tell_what_a_deformation_network_moves_far() -> None:
    """The match holds in any order, although most Gaussians moved farther than their spacing."""
    deforming = Deforming(4000, 3)
    before, after = deforming.next(), deforming.next()
    continued, same = match(before, after)
    goes_on = continued >= 0
    assert goes_on.mean() > 0.97
    equal = (before.sh[continued[goes_on]] == after.sh[goes_on]).all(axis=(1, 2))
    assert equal.mean() > 0.99
    assert not same.any()


def test_colours_that_many_share_tell_nothing() -> None:
    before = figure(2000)
    grey = Splats(*before.arrays[:4], np.full((2000, 1, 3), 0.25, np.float32))
    order = np.random.default_rng(1).permutation(2000)
    after = turned(grey, 0.01).take(order)
    continued, _ = match(grey, after)
    right = continued == order
    assert right[continued >= 0].mean() > 0.9


@pytest.mark.parametrize("count", [3000, 12000])
def test_the_order_of_the_files_tells_where_everything_moves_far(count: int) -> None:
    before, after = figure(count), turned(figure(count), 0.1)
    continued, same = match(before, after)
    assert (continued == np.arange(count)).mean() > 0.999
    assert not same.all()


def test_place_and_looks_tell_where_the_order_does_not() -> None:
    before = figure(4000)
    order = np.random.default_rng(0).permutation(4000)
    after = turned(before, 0.02).take(order)
    continued, _ = match(before, after)
    assert (continued == order).mean() > 0.8
    # With some Gaussians gone and others new, there are still few mistakes.
    stays = np.arange(4000) >= 300
    continued, _ = match(before.take(np.flatnonzero(stays)), after)
    true = np.where(stays[order], order - 300, -1)
    assert (continued == true).mean() > 0.75


def test_two_files_that_have_nothing_to_do_with_each_other_have_few_pairs() -> None:
    before, after = trained_like_splats(2000, 1), trained_like_splats(2000, 2)
    continued, same = match(before, after)
    assert not same.any()
    far = continued >= 0
    moves_m = np.linalg.norm(after.means[far] - before.means[continued[far]], axis=1)
    sizes_m = np.exp(np.sort(before.log_scales[continued[far]], axis=1)[:, 1:].mean(axis=1))
    assert far.mean() < 0.3
    assert (moves_m <= 4.01 * sizes_m + 1e-6).mean() > 0.9
