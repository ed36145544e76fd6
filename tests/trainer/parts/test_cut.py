"""Parts cover a capture in whole segments."""

from __future__ import annotations

from itertools import pairwise

import pytest
from hypothesis import given
from hypothesis import strategies as st

from codec.errors import InvalidError
from trainer.parts.cut import cut


@given(st.integers(1, 2000), st.integers(2, 400), st.integers(1, 30), st.integers(1, 3))
def test_parts_follow_each_other_in_whole_segments_longer_than_a_seam(
    num_frames: int, part_frames: int, segment_frames: int, seam_segments: int
) -> None:
    seam_frames = seam_segments * segment_frames
    if part_frames <= seam_frames:
        with pytest.raises(InvalidError, match="more than"):
            cut(num_frames, part_frames, segment_frames, seam_frames)
        return
    parts = cut(num_frames, part_frames, segment_frames, seam_frames)
    assert [part.number for part in parts] == list(range(len(parts)))
    assert parts[0].first_frame == 0
    assert parts[-1].end_frame == num_frames
    for one, other in pairwise(parts):
        assert one.end_frame == other.first_frame
        assert one.end_frame % segment_frames == 0
    for part in parts[1:]:
        assert part.end_frame - part.first_frame > seam_frames
    longest = max(part.end_frame - part.first_frame for part in parts)
    assert longest < part_frames + segment_frames + seam_frames
