"""Requests and responses, compared with a naive reading of RFC 9110, 13 and 14."""

from __future__ import annotations

import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from multidict import CIMultiDict

from server.exchange.byterange import parse_range
from server.exchange.content import IMMUTABLE, Content, respond
from server.exchange.errors import RequestError
from server.exchange.request import Request, read_request
from server.exchange.response import error_response, fields_text

PATHS = st.text("".join(chr(c) for c in range(0x21, 0x7F) if chr(c) not in "?#"), max_size=30)
QUERIES = st.text("".join(chr(c) for c in range(0x21, 0x7F) if chr(c) != "#"), max_size=20)
HOSTS = st.sampled_from(["h", "a.example:8080", "127.0.0.1:1", "[::1]:65535", "[2001:db8::1]"])


def read(target: str, *fields: tuple[str, str], method: str = "GET") -> Request:
    return read_request(method, target, CIMultiDict(fields))


@given(PATHS, st.none() | QUERIES, HOSTS, st.none() | HOSTS)
def test_a_target_is_read_back(
    path: str, query: str | None, host: str, authority: str | None
) -> None:
    target = f"/{path}" + ("" if query is None else f"?{query}")
    before = "" if authority is None else f"http://{authority}"
    request = read(before + target, ("Host", host))
    assert (request.path, request.query) == (f"/{path}", query or "")
    assert request.host == (authority or host)


def test_lines_of_one_field_are_one_list() -> None:
    request = read("/", ("If-None-Match", '"a"'), ("if-none-match", '"b"'))
    assert request.joined("If-None-Match") == '"a", "b"'
    assert request.joined("If-Match") == ""


texts = st.text(max_size=20) | st.text("ab:\r\n", max_size=8)


@given(st.dictionaries(texts, texts, max_size=4))
@example({"X": "a\r\nSet-Cookie: b"})
@example({"a\nb": "x"})
def test_no_field_breaks_out_of_its_line(fields: dict[str, str]) -> None:
    try:
        data = fields_text(fields)
    except ValueError as error:  # more than one line, or not latin-1
        assert "more than one line" in str(error) or "latin-1" in str(error)  # noqa: PT017
        return
    lines = data.split(b"\r\n")
    assert lines.pop() == b""
    assert len(lines) == len(fields)
    assert data.count(b"\n") == data.count(b"\r") == len(fields)


def test_an_error_is_one_line_whatever_it_says() -> None:
    response = error_response(400, 'a "b"\n\r\u2028\x00<script>', {"Allow": "GET"})
    assert b"\n" not in response.body
    assert response.fields["Cache-Control"] == "no-store"
    assert response.fields["Allow"] == "GET"


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


def request(method: str, fields: dict[str, str]) -> Request:
    return Request(method, "/x", "", "h", CIMultiDict(fields))


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


def model(method: str, fields: dict[str, str], can_code: bool) -> tuple[int, bytes, str]:
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
    return status, b"" if method == "HEAD" else body, tag


@given(st.sampled_from(["GET", "HEAD"]), FIELDS, st.booleans())
def test_it_is_as_the_rfc_says(method: str, fields: dict[str, str], can_code: bool) -> None:
    status, body, tag = model(method, fields, can_code)
    asked = request(method, fields)
    if status in (412, 416):
        with pytest.raises(RequestError) as caught:
            respond(asked, content(can_code))
        assert caught.value.status == status
        if status == 416:
            assert caught.value.headers["Content-Range"] == "bytes */100"
        return
    response = respond(asked, content(can_code))
    assert (response.status, bytes(response.body)) == (status, body)
    assert response.fields["ETag"] == tag
    assert ("Content-Encoding" in response.fields) == (tag == CODED)
    # A cache must know the other variants, whichever this client received.
    assert ("Vary" in response.fields) == can_code
    assert not (status == 206 and tag == CODED)
    if status == 206:
        first, last = response.fields["Content-Range"][6:].split("/")[0].split("-")
        assert DATA[int(first) : int(last) + 1] == body or method == "HEAD"
    if method == "HEAD" and status == 200:
        assert response.length == len(DATA)


def test_bytes_on_their_way_are_counted() -> None:
    counted: list[int] = []
    one = Content(DATA, "f00d", "text/plain", IMMUTABLE, count=counted.append)
    respond(request("GET", {}), one)
    respond(request("GET", {"range": "bytes=5-9"}), one)
    respond(request("GET", {"if-none-match": TAG}), one)
    respond(request("HEAD", {}), one)
    assert counted == [100, 5]
