"""The rectangles that cover the changes of a slice."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from codec.errors import InvalidError
from codec.slice import Slice
from player.render.upload import FIRST_GAP, MAX_PATCHES, PackedLanes, rectangles_of
from tests.support.hosted_streams import random_slice, random_splats


@given(
    st.integers(1, 40_000),
    st.floats(0, 1),
    st.floats(0, 1),
    st.sampled_from((341, 512)),
    st.integers(0, 1000),
)
def test_few_rectangles_cover_all_rows(
    slots: int, share: float, kept: float, columns: int, seed: int
) -> None:
    rng = np.random.default_rng(seed)
    chosen = (rng.random(slots) < share) & (rng.random(slots // 100 + 1) < kept).repeat(100)[:slots]
    rows = np.flatnonzero(chosen).astype(np.int32)
    rectangles = rectangles_of(rows, columns)
    assert len(rectangles) <= min(MAX_PATCHES, len(rows))
    covered = np.zeros((-(-slots // columns), columns), np.bool_)
    for top, bottom, left, right in rectangles:
        assert 0 <= top < bottom <= len(covered)
        assert 0 <= left < right <= columns
        covered[top:bottom, left:right] = True
    assert covered.ravel()[rows].all()
    # Each edge touches a change, so that no rectangle could be smaller.
    grid = np.zeros_like(covered)
    grid.ravel()[rows] = True
    for top, bottom, left, right in rectangles:
        inside = grid[top:bottom, left:right]
        assert inside[0].any()
        assert inside[-1].any()
        assert inside[:, 0].any()
        assert inside[:, -1].any()


def test_neighbours_are_written_together_and_no_others() -> None:
    def of(*rows: int) -> list[list[int]]:
        rectangles = rectangles_of(np.array(rows, np.int32), 512)
        return [[int(edge) for edge in one] for one in rectangles]

    assert of() == []
    assert of(5) == [[0, 1, 5, 6]]
    assert of(5, 6 + FIRST_GAP) == [[0, 1, 5, 7 + FIRST_GAP]]
    assert of(5, 7 + FIRST_GAP) == [[0, 1, 5, 6], [0, 1, 7 + FIRST_GAP, 8 + FIRST_GAP]]
    # One below the other.
    assert of(5, 512 + 5, 1024 + 6) == [[0, 3, 5, 7]]
    # The end of one row and the beginning of the next are far apart.
    assert of(511, 512) == [[0, 1, 511, 512], [1, 2, 0, 1]]
    assert of(*range(300, 2100)) == [[0, 1, 300, 512], [1, 4, 0, 512], [4, 5, 0, 52]]


def test_what_is_handed_out_does_not_change() -> None:
    lanes = PackedLanes(2, 1000, 0, columns=512)
    whole = lanes.pack(random_slice(0, 1000, 0))
    handed = [patch.texels.copy() for patch in whole.patches]
    rows = np.arange(0, 1000, 2, dtype=np.int32)
    parts = []
    for birth in (2, 4):
        splats = random_splats(500, 0, birth)
        parts.append(lanes.pack(Slice(birth, splats, np.zeros(500, np.uint8), rows)))
        handed += [patch.texels.copy() for patch in parts[-1].patches]
    after = [patch.texels for packed in (whole, *parts) for patch in packed.patches]
    for before, texels in zip(handed, after, strict=True):
        np.testing.assert_array_equal(before, texels)
    # Unchanged texels in between are uploaded unchanged.
    np.testing.assert_array_equal(parts[1].patches[0].texels[0, 4:8], handed[0][0, 4:8])

    part = Slice(3, splats, np.zeros(500, np.uint8), rows)
    with pytest.raises(InvalidError, match="its lane holds nothing"):
        lanes.pack(part)
