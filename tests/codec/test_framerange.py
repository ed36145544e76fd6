"""Ranges of frames as text, and their meaning for the length of a stream or capture."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from codec.errors import InvalidError
from codec.framerange import FrameRange


@given(st.builds(FrameRange, st.integers(0, 99), st.none() | st.integers(100, 999)))
def test_text_and_range_are_the_same(frames: FrameRange) -> None:
    assert FrameRange.parse(str(frames)) == frames


@pytest.mark.parametrize(
    ("text", "frames"),
    [("3:7", range(3, 7)), (":", range(10)), ("5:", range(5, 10)), (":2", range(2))],
)
def test_the_frames_of_a_capture(text: str, frames: range) -> None:
    assert FrameRange.parse(text).of(10, "it") == frames
    assert FrameRange.parse(":9").count == 9
    assert FrameRange.parse("4:").count is None


@pytest.mark.parametrize("text", ["0:11", "10:", "12:14"])
def test_ranges_that_are_refused(text: str) -> None:
    with pytest.raises(InvalidError, match=f"frames {text}: it has frames 0:10"):
        FrameRange.parse(text).of(10, "it")
    for frames, count in ((FrameRange(), 0), (FrameRange(-1, 0), 10)):
        with pytest.raises(InvalidError, match=f"has frames 0:{count}"):
            frames.of(count, "it")
    for wrong in ("", "5", "9:3", "3:3", "a:b", "-1:4", "1:2:3", "\u0663:", "5" * 5000 + ":"):
        with pytest.raises(InvalidError, match="frames") as caught:
            FrameRange.parse(wrong)
        assert len(str(caught.value)) < 200
