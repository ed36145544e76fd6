"""What a slice is: whole, or some rows of its lane."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given

from codec.errors import InvalidError
from codec.slice import HIDDEN, MAX_SWIN_SIZE, Slice, active_splats, blank_splats, window_births
from codec.splats import Splats
from tests.support.hosted_streams import random_slice, random_splats
from tests.support.slots.leases import LeasedStream, leased_streams, replayed


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


@given(leased_streams())
def test_whole_slices_follow_from_changes(stream: LeasedStream) -> None:
    swin_size, window = stream.swin_size, dict[int, Slice]()
    for slice in stream.slices:
        lane = slice.lane(swin_size)
        window[lane] = slice.onto(window[lane], swin_size) if lane in window else slice
        frame = slice.birth
        if frame < 0:
            continue
        whole = [window[birth % swin_size] for birth in window_births(frame, swin_size)]
        assert [part.rows for part in whole] == [None] * swin_size
        got = active_splats(whole, frame, swin_size)
        expected = Splats.concatenate(replayed(stream.slices, frame, swin_size))
        for array, wanted in zip(got.arrays, expected.arrays, strict=True):
            np.testing.assert_array_equal(array, wanted)


def test_what_is_put_onto_stays_as_it_was() -> None:
    before = random_slice(0, 6)
    means = before.splats.means.copy()
    after = change(4, 1, 8).onto(before, 4)
    np.testing.assert_array_equal(before.splats.means, means)
    assert len(after.splats) == 9
    assert after.start_offsets.tolist() == [0] * 6 + [HIDDEN] * 2 + [0]


def test_what_it_cannot_be_put_onto() -> None:
    before = random_slice(0, 6)
    with pytest.raises(
        InvalidError, match="changes the one born at 1; its lane holds the one born"
    ):
        change(5, 1).onto(before, 4)
    with pytest.raises(InvalidError, match="its lane holds nothing"):
        change(5, 1).check_follows(None, 4)
    with pytest.raises(InvalidError, match="the slice born at 0 has rows"):
        change(4, 1).onto(change(0, 1), 4)
    with pytest.raises(InvalidError, match="has SH degree 0, the one before 1"):
        change(4, 1, sh_degree=0).onto(before, 4)
    with pytest.raises(InvalidError, match="the slice born at 4 has rows"):
        active_splats([before, change(4, 1)], 4, 4)


def test_a_whole_slice_takes_no_notice_of_the_one_before() -> None:
    whole = random_slice(9, 3)
    assert whole.onto(random_slice(0, 6), 4) is whole


@pytest.mark.parametrize("sh_degree", [0, 1, 3])
def test_blank_ones_are_valid(sh_degree: int) -> None:
    assert len(blank_splats(3, sh_degree)) == 3
    assert blank_splats(0, sh_degree).sh_degree == sh_degree
