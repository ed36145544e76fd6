"""The Range header against a plain reading of RFC 9110."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from server.http.byterange import UNSATISFIABLE, ByteRange, parse_range

CASES = [
    (None, 10, None),
    ("", 10, None),
    ("bytes=0-0", 10, ByteRange(0, 1)),
    ("bytes=0-", 10, ByteRange(0, 10)),
    ("Bytes= 2-4 ", 10, ByteRange(2, 5)),
    ("bytes=2-400", 10, ByteRange(2, 10)),
    ("bytes=-3", 10, ByteRange(7, 10)),
    ("bytes=-300", 10, ByteRange(0, 10)),
    ("bytes=-0", 10, UNSATISFIABLE),
    ("bytes=10-", 10, UNSATISFIABLE),
    ("bytes=10-12", 10, UNSATISFIABLE),
    ("bytes=0-", 0, UNSATISFIABLE),
    ("bytes=-5", 0, UNSATISFIABLE),
    ("bytes=5-4", 10, None),
    ("bytes=-", 10, None),
    ("bytes=1-2,4-5", 10, None),
    ("bytes=a-b", 10, None),
    ("bytes=--1", 10, None),
    ("bytes=+1-2", 10, None),
    ("bytes=\u0661-\u0662", 10, None),
    ("items=0-1", 10, None),
    ("bytes 0-1", 10, None),
    ("bytes=" + "9" * 5000 + "-", 10, None),
]


@pytest.mark.parametrize(("header", "size", "expected"), CASES)
def test_cases(header: str | None, size: int, expected: object) -> None:
    assert parse_range(header, size) == expected


@given(st.integers(0, 50), st.integers(0, 50), st.integers(1, 40))
def test_a_range_is_a_slice(first: int, last: int, size: int) -> None:
    data = bytes(range(size))
    found = parse_range(f"bytes={first}-{last}", size)
    if last < first:
        assert found is None
    elif first >= size:
        assert found is UNSATISFIABLE
    else:
        assert isinstance(found, ByteRange)
        assert data[found.start : found.stop] == data[first : last + 1]


@given(st.text(max_size=30), st.integers(0, 1 << 40))
def test_any_text_gives_a_range_inside_or_none(header: str, size: int) -> None:
    for text in (header, f"bytes={header}"):
        found = parse_range(text, size)
        if isinstance(found, ByteRange):
            assert 0 <= found.start < found.stop <= size
