"""Ranges of frames as text, and their meaning for the length of a stream or capture."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from codec.errors import InvalidError
from codec.framerange import FrameRange


def test_ranges_as_text() -> None:
    assert FrameRange.parse("3:9") == FrameRange(3, 9)
    assert FrameRange.parse(":9").count == 9
    assert FrameRange.parse("4:").count is None
    for text in ("", "5", "9:3", "3:3", "a:b", "-1:4", "1:2:3", "\u0663:", "5" * 19 + ":"):
        with pytest.raises(InvalidError, match="frames"):
            FrameRange.parse(text)


@given(st.builds(FrameRange, st.integers(0, 99), st.none() | st.integers(100, 999)))
def test_text_and_range_are_the_same(frames: FrameRange) -> None:
    assert FrameRange.parse(str(frames)) == frames


def test_the_frames_of_a_capture() -> None:
    assert FrameRange.parse("3:7").of(10, "it") == range(3, 7)
    assert FrameRange.parse(":").of(10, "it") == range(10)
    assert FrameRange.parse("5:").of(10, "it") == range(5, 10)
    assert FrameRange.parse(":2").of(10, "it") == range(2)
    for text in ("0:11", "10:", "12:14"):
        with pytest.raises(InvalidError, match=f"frames {text}: it has frames 0:10"):
            FrameRange.parse(text).of(10, "it")
    with pytest.raises(InvalidError, match="has frames 0:0"):
        FrameRange().of(0, "it")
    with pytest.raises(InvalidError, match="has frames 0:10"):
        FrameRange(-1, 0).of(10, "it")
