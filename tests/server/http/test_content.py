"""Ranges and conditions, compared with a naive reading of RFC 9110, 13 and 14."""

from __future__ import annotations

import json

import pytest
from aiohttp import web
from aiohttp.test_utils import make_mocked_request
from hypothesis import given
from hypothesis import strategies as st
from multidict import CIMultiDict

from server.http.content import IMMUTABLE, Content, parse_range, part_of, serve
from server.http.errors import RequestError


def test_an_error_is_one_line_whatever_it_says() -> None:
    error = RequestError(400, said := 'a "b"\n\r\u2028\x00<script>', {"Allow": "GET"})
    assert error.text is not None
    assert error.text.isprintable()
    assert json.loads(error.text) == {"error": said}
    assert (error.status, str(error), error.headers["Allow"]) == (400, said, "GET")
    assert error.headers["Cache-Control"] == "no-store"


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


DATA = bytes(range(100))
TAG, CODED, OTHER = '"f00d"', '"f00d-zstd"', '"beef"'


def content(can_code: bool) -> Content:
    coded = {"zstd": DATA} if can_code else {}
    return Content(DATA, "f00d", "application/octet-stream", IMMUTABLE, coded)


def request(method: str, fields: dict[str, str]) -> web.Request:
    return make_mocked_request(method, "/x", CIMultiDict(fields))


TAGS = st.lists(
    st.sampled_from([TAG, CODED, OTHER, f"W/{TAG}", f"W/{CODED}", "*", "", "f00d"]), max_size=3
).map(", ".join)
RANGES = st.one_of(
    st.tuples(st.integers(0, 120), st.integers(0, 120)).map(
        lambda pair: f"bytes={pair[0]}-{pair[1]}"
    ),
    st.integers(0, 120).map(lambda n: f"bytes={n}-"),
    st.integers(0, 120).map(lambda n: f"bytes=-{n}"),
    st.sampled_from(["bytes=0-1,3-4", "lines=1-2", "bytes", ""]),
)
FIELDS = st.fixed_dictionaries(
    {},
    optional={
        "if-match": TAGS,
        "if-none-match": TAGS,
        "range": RANGES,
        "if-range": st.sampled_from(
            [TAG, CODED, OTHER, f"W/{TAG}", "Tue, 01 Jan 2030 00:00:00 GMT"]
        ),
        "accept-encoding": st.sampled_from(
            ["zstd", "gzip, ZSTD;q=0.1", "zstd;q=0", "zstd; q=0.000", "*", "", "br"]
        ),
    },
)


def listed(text: str) -> list[str]:
    return [part.strip() for part in text.split(",")]


def model(fields: dict[str, str], can_code: bool) -> tuple[int, bytes, str]:
    """Status, body and tag, by the steps of section 13.2.2."""
    takes = fields.get("accept-encoding", "") in ("zstd", "gzip, ZSTD;q=0.1")
    coded = can_code and takes and "range" not in fields
    tag = CODED if coded else TAG
    if "if-match" in fields and not {tag, "*"} & set(listed(fields["if-match"])):
        return 412, b"", tag
    if "if-none-match" in fields:
        weak = [part.removeprefix("W/") for part in listed(fields["if-none-match"])]
        if tag in weak or "*" in weak:
            return 304, b"", tag
    status, body = 200, DATA
    text = fields.get("range", "")
    if text.startswith("bytes=") and "," not in text and fields.get("if-range", tag) == tag:
        first, _, last = text.removeprefix("bytes=").partition("-")
        if not first:
            status, body = 206, DATA[-int(last) :] if int(last) else b""
        elif not last or int(first) <= int(last):
            stop = int(last) + 1 if last else len(DATA)
            status, body = 206, DATA[int(first) : stop]
        if status == 206 and not body:
            return 416, b"", tag
    return status, body, tag


@given(st.sampled_from(["GET", "HEAD"]), FIELDS, st.booleans())
def test_it_is_as_the_rfc_says(method: str, fields: dict[str, str], can_code: bool) -> None:
    status, body, tag = model(fields, can_code)
    asked = request(method, fields)
    if status in (412, 416):
        with pytest.raises(RequestError) as caught:
            part_of(content(can_code), asked)
        assert caught.value.status == status
        if status == 416:
            assert caught.value.headers["Content-Range"] == "bytes */100"
        return
    part = part_of(content(can_code), asked)
    assert (part.status, bytes(part.body)) == (status, body)
    assert part.headers["ETag"] == tag
    assert ("Content-Encoding" in part.headers) == (tag == CODED)
    # A cache must know the other variants, whichever this client received.
    assert ("Vary" in part.headers) == can_code
    assert not (status == 206 and tag == CODED)
    if status == 206:
        first, last = part.headers["Content-Range"][6:].split("/")[0].split("-")
        assert DATA[int(first) : int(last) + 1] == body


@pytest.mark.anyio
async def test_bytes_on_their_way_are_counted() -> None:
    counted: list[int] = []
    one = Content(DATA, "f00d", "text/plain", IMMUTABLE, count=counted.append)
    for method, fields, body in (
        ("GET", {}, DATA),
        ("GET", {"range": "bytes=5-9"}, DATA[5:10]),
        ("GET", {"if-none-match": TAG}, b""),
        ("HEAD", {}, DATA),  # of which only the length is sent
    ):
        response = await serve(request(method, fields), one)
        assert isinstance(response, web.Response)
        assert response.body == body
    assert counted == [100, 5]
