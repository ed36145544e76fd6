"""The Range header, compared with a plain reading of RFC 9110."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from server.exchange.byterange import parse_range

CASES = [
    ("", 10, None),
    ("bytes=0-0", 10, range(0, 1)),
    ("bytes=0-", 10, range(0, 10)),
    ("Bytes= 2-4 ", 10, range(2, 5)),
    ("bytes=2-400", 10, range(2, 10)),
    ("bytes=-3", 10, range(7, 10)),
    ("bytes=-300", 10, range(0, 10)),
    ("bytes=-0", 10, range(0)),
    ("bytes=10-", 10, range(0)),
    ("bytes=10-12", 10, range(0)),
    ("bytes=0-", 0, range(0)),
    ("bytes=-5", 0, range(0)),
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
def test_cases(header: str, size: int, expected: object) -> None:
    assert parse_range(header, size) == expected


@given(st.text(max_size=30), st.integers(0, 1 << 40))
def test_any_text_gives_a_range_inside_or_none(header: str, size: int) -> None:
    for text in (header, f"bytes={header}"):
        found = parse_range(text, size)
        if found:
            assert 0 <= found.start < found.stop <= size
