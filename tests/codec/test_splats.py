"""An existing `Splats` or `Slice` is valid; the constructor states any fault."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from codec.arrays import Floats
from codec.errors import InvalidError
from codec.slice import HIDDEN, MAX_SWIN_SIZE, Slice, active_splats, blank_splats
from codec.splats import ARRAY_NAMES, array_shapes
from tests.support.hosted_streams import random_slice, random_splats
from tests.support.hostile import refused
from tests.support.trained_like import trained_like_splats

GOOD = trained_like_splats(4, sh_degree=1)


def altered(array: Floats, value: float) -> Floats:
    """`array` with another first number."""
    copy = array.copy()
    copy.flat[0] = value
    return copy


@pytest.mark.parametrize("sh_degree", range(4))
def test_arrays_have_the_shapes_that_are_promised(sh_degree: int) -> None:
    splats = trained_like_splats(3, sh_degree=sh_degree)
    assert tuple(array.shape for array in splats.arrays) == array_shapes(3, sh_degree)
    assert (len(splats), splats.sh_degree) == (3, sh_degree)
    assert splats.num_bytes == 3 * 4 * (11 + 3 * (sh_degree + 1) ** 2)


def test_rows_are_taken_by_numbers_a_skip_map_or_a_slice() -> None:
    skip_map = np.array([False, True, False, True])
    for rows in (np.array([1, 3]), skip_map, slice(1, None, 2)):
        for taken, array in zip(GOOD.take(rows).arrays, GOOD.arrays, strict=True):
            np.testing.assert_array_equal(taken, array[skip_map])


def test_another_degree_keeps_what_both_have() -> None:
    more, less = GOOD.with_degree(3), GOOD.with_degree(0)
    assert (more.sh_degree, less.sh_degree) == (3, 0)
    np.testing.assert_array_equal(more.sh[:, :4], GOOD.sh)
    assert not more.sh[:, 4:].any()
    np.testing.assert_array_equal(less.sh, GOOD.sh[:, :1])
    np.testing.assert_array_equal(more.means, GOOD.means)


@pytest.mark.parametrize("name", ARRAY_NAMES)
def test_the_array_at_fault_is_named(name: str) -> None:
    array = getattr(GOOD, name)
    for wrong, says in (
        (np.concatenate([array, array[:1]]), "has shape"),
        (array.astype(np.float64), "is float64, expected float32"),
        (altered(array, np.nan), "holds a value that is not finite"),
        (altered(array, -np.inf), "holds a value that is not finite"),
    ):
        if name == "means" and says == "has shape":
            continue  # the means define the count, so that another array is at fault
        refused(InvalidError, rf"^Splats\.{name} {says}", replace, GOOD, **{name: wrong})


def test_harmonics_are_those_of_a_whole_degree() -> None:
    refused(InvalidError, "has 3 coefficients, not 1, 4, 9 or 16", replace, GOOD, sh=GOOD.sh[:, :3])


def test_a_zero_quaternion_turns_nothing() -> None:
    quats = GOOD.quats.copy()
    quats[2] = (0.0, -0.0, 0.0, 0.0)
    refused(InvalidError, "holds a zero quaternion", replace, GOOD, quats=quats)
    quats[2] = (0, 0, 1e-45, 0)
    assert len(replace(GOOD, quats=quats)) == 4


def rows_of(*rows: int) -> np.ndarray[tuple[int], np.dtype[np.int32]]:
    return np.array(rows, np.int32)


def change(birth: int, *rows: int, offset: int = 0, sh_degree: int = 1) -> Slice:
    """A slice that changes `rows`."""
    offsets = np.full(len(rows), offset, np.uint8)
    return Slice(birth, random_splats(len(rows), sh_degree, birth), offsets, rows_of(*rows))


def test_rows_rise_and_offsets_are_bytes() -> None:
    splats, offsets = random_splats(2, 0, 1), np.zeros(2, np.uint8)
    for wrong, says in (
        ((splats, np.zeros(3, np.uint8)), r"has shape \(3,\)"),
        ((splats, np.zeros(2, np.int64)), "is int64, not uint8"),
        ((splats, offsets, rows_of(0, 1, 2)), r"Slice.rows has shape \(3,\)"),
        ((splats, offsets, np.array([0, 1])), r"Slice\.rows is int64, not int32"),
        *(((splats, offsets, rows_of(*n)), "does not rise") for n in ((-1, 0), (1, 1), (1, 0))),
    ):
        refused(InvalidError, says, Slice, 0, *wrong)
    whole, part = random_slice(0, 40), change(4, 3, 30)
    assert whole.num_bytes == 40 * (4 * (11 + 12) + 1)
    assert part.num_bytes == 2 * (4 * (11 + 12) + 1 + 4)
    for sh_degree in (0, 1, 3):
        assert len(blank_splats(3, sh_degree)) == 3
        assert blank_splats(0, sh_degree).sh_degree == sh_degree


@pytest.mark.parametrize("swin_size", [1, 2, MAX_SWIN_SIZE])
def test_what_shows_when(swin_size: int) -> None:
    """From its offset to the end of the window; a hidden one never."""
    offsets = np.array([0, swin_size - 1, HIDDEN], np.uint8)
    part = Slice(-7, random_splats(3, 0, 1), offsets)
    for frame in range(-9, swin_size):
        shown = [-7 <= frame < swin_size - 7, frame == swin_size - 8, False]
        assert part.active(frame, swin_size).tolist() == shown
    assert part.lane(swin_size) == -7 % swin_size


def test_what_it_cannot_follow() -> None:
    with pytest.raises(
        InvalidError, match="changes the one born at 1; its lane holds the one born"
    ):
        change(5, 1).check_follows(0, 4)
    refused(InvalidError, "its lane holds nothing", lambda: change(5, 1).check_follows(None, 4))
    with pytest.raises(InvalidError, match="the slice born at 4 has rows"):
        active_splats([random_slice(0, 6), change(4, 1)], 4, 4)
