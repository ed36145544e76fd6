"""Slices: whole ones, and those with some rows of their lane."""

from __future__ import annotations

import numpy as np
import pytest

from codec.errors import InvalidError
from codec.slice import HIDDEN, MAX_SWIN_SIZE, Slice, active_splats, blank_splats
from tests.support.hosted_streams import random_slice, random_splats


def rows_of(*rows: int) -> np.ndarray[tuple[int], np.dtype[np.int32]]:
    return np.array(rows, np.int32)


def change(birth: int, *rows: int, offset: int = 0, sh_degree: int = 1) -> Slice:
    """A slice that changes `rows`."""
    offsets = np.full(len(rows), offset, np.uint8)
    return Slice(birth, random_splats(len(rows), sh_degree, birth), offsets, rows_of(*rows))


def test_rows_rise_within_the_slice() -> None:
    splats, offsets = random_splats(2, 0, 1), np.zeros(2, np.uint8)
    with pytest.raises(InvalidError, match=r"Slice.rows has shape \(3,\)"):
        Slice(0, splats, offsets, rows_of(0, 1, 2))
    with pytest.raises(InvalidError, match=r"Slice\.rows is int64, not int32"):
        Slice(0, splats, offsets, np.array([0, 1]))
    for wrong in (rows_of(-1, 0), rows_of(1, 1), rows_of(1, 0)):
        with pytest.raises(InvalidError, match="does not rise"):
            Slice(0, splats, offsets, wrong)


@pytest.mark.parametrize("swin_size", [1, 2, MAX_SWIN_SIZE])
def test_a_hidden_one_never_shows(swin_size: int) -> None:
    part = Slice(-7, random_splats(2, 0, 1), np.array([0, HIDDEN], np.uint8))
    frames = range(-9, swin_size)
    shown = [part.active(frame, swin_size).tolist() for frame in frames]
    assert shown == [[-7 <= frame < swin_size - 7, False] for frame in frames]


def test_the_last_offset_of_the_longest_window_shows() -> None:
    part = Slice(0, random_splats(1, 0, 1), np.array([MAX_SWIN_SIZE - 1], np.uint8))
    shown = [frame for frame in range(300) if part.active(frame, MAX_SWIN_SIZE).any()]
    assert shown == [MAX_SWIN_SIZE - 1]


def test_only_what_it_holds_is_counted() -> None:
    whole, part = random_slice(0, 40), change(4, 3, 30)
    assert whole.num_bytes == 40 * (4 * (11 + 12) + 1)
    assert part.num_bytes == 2 * (4 * (11 + 12) + 1 + 4)


def test_what_it_cannot_follow() -> None:
    with pytest.raises(
        InvalidError, match="changes the one born at 1; its lane holds the one born"
    ):
        change(5, 1).check_follows(0, 4)
    with pytest.raises(InvalidError, match="its lane holds nothing"):
        change(5, 1).check_follows(None, 4)
    with pytest.raises(InvalidError, match="the slice born at 4 has rows"):
        active_splats([random_slice(0, 6), change(4, 1)], 4, 4)


@pytest.mark.parametrize("sh_degree", [0, 1, 3])
def test_blank_ones_are_valid(sh_degree: int) -> None:
    assert len(blank_splats(3, sh_degree)) == 3
    assert blank_splats(0, sh_degree).sh_degree == sh_degree
