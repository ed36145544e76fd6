"""Heads of requests: any bytes give a request or an error, and what was written is read back."""

from __future__ import annotations

import random

import pytest
from hypothesis import assume, example, given
from hypothesis import strategies as st

from server.http.errors import RequestError
from server.http.request import MAX_FIELDS, MAX_LINE_BYTES, HeadParser, Request
from tests.server.hostile.requestcases import CASES

HEADS = [case.sent.partition(b"\r\n\r\n")[0] for case in CASES]

TOKEN = "!#$%&'*+.^_`|~0123456789ABCXYZabcxyz-"
PATHS = st.text("".join(chr(c) for c in range(0x21, 0x7F) if chr(c) not in "?#"), max_size=30)
QUERIES = st.text("".join(chr(c) for c in range(0x21, 0x7F) if chr(c) != "#"), max_size=20)
VALUES = st.text(
    st.characters(min_codepoint=0x20, max_codepoint=0xFF, exclude_characters="\x7f")
    | st.just("\t"),
    max_size=30,
).map(lambda text: text.strip(" \t"))
MEANT = ("host", "content-length", "transfer-encoding", "expect", "connection")
"""Names of fields that are more than text to the parser."""
NAMES = st.text(TOKEN, min_size=1, max_size=12).filter(lambda name: name.lower() not in MEANT)
FIELDS = st.lists(st.tuples(NAMES, VALUES), max_size=6)
HOSTS = st.sampled_from(["h", "a.example:8080", "127.0.0.1:1", "[::1]:65535", "[2001:db8::1]"])


def parse(head: bytes, max_body_bytes: int = 1024) -> Request:
    return HeadParser(max_body_bytes).parse(head)


def outcome(parser: HeadParser, head: bytes) -> Request | tuple[int, str]:
    """What it gives; an error as its status and message."""
    try:
        return parser.parse(head)
    except RequestError as error:
        return error.status, str(error)


def check(head: bytes) -> None:
    """The law: a request whose parts hold nothing that could end a line, or an error status."""
    found = outcome(HeadParser(1024), head)
    if isinstance(found, tuple):
        status, message = found
        assert status in (400, 411, 413, 414, 417, 431, 505)
        assert message.isascii()
        assert message.isprintable()
        return
    for text in (found.method, found.path, found.query, found.host):
        assert text.isascii()
        assert text.isprintable()
        assert " " not in text
    assert found.path.startswith("/") or (found.method.endswith("OPTIONS") and found.path == "*")
    assert 0 <= found.body_bytes <= 1024
    for name, value in found.fields.items():
        assert name == name.lower()
        assert not set(value) & set("\r\n\0")


@given(st.binary(max_size=400))
def test_any_bytes_give_a_request_or_an_error(head: bytes) -> None:
    check(head)


@given(st.sampled_from(HEADS), st.randoms(use_true_random=False))
def test_what_is_near_a_hostile_request_gives_a_request_or_an_error(
    head: bytes, rng: random.Random
) -> None:
    altered = bytearray(head[:2000])
    for _ in range(rng.randint(0, 3)):
        place = rng.randrange(len(altered) + 1)
        altered[place : place + rng.randint(0, 2)] = bytes(
            rng.choices(b"\r\n\t :/%?\0\xff09aA", k=1)
        )
    check(bytes(altered))


@given(st.text(TOKEN, min_size=1, max_size=32), PATHS, st.none() | QUERIES, HOSTS, FIELDS)
def test_a_head_is_read_back(
    method: str, path: str, query: str | None, host: str, fields: list[tuple[str, str]]
) -> None:
    target = f"/{path}" + ("" if query is None else f"?{query}")
    lines = [f"{method} {target} HTTP/1.1", f"Host: {host}"]
    lines += [f"{name}:{' ' * (n % 3)}{value}" for n, (name, value) in enumerate(fields)]
    request = parse("\r\n".join(lines).encode("latin-1"))
    assert (request.method, request.path, request.host) == (method, f"/{path}", host)
    assert request.query == (query or "")
    expected: dict[str, list[str]] = {"host": [host]}
    for name, value in fields:
        expected.setdefault(name.lower(), []).append(value)
    assert request.fields == {name: ", ".join(values) for name, values in expected.items()}
    assert request.keep_alive
    assert request.chunks
    assert request.body_bytes == 0


BLOCKS = st.sampled_from(
    [
        "",
        "Host: h",
        "Host: h\r\nRange: bytes=0-1",
        "Host: h\r\nConnection: close",
        "Host: other:80\r\nConnection: keep-alive",
        "Host: h\r\nContent-Length: 5",
        "Host: h\r\nContent-Length: 5000",
        "Host: h\r\nAccept-Encoding: zstd",
        "Host: h\r\nHost: h",
        "Host: [",
        "Connection: keep-alive",
        "nonsense",
    ]
)
LINES = st.sampled_from(
    [
        "GET / HTTP/1.1",
        "GET /a?b HTTP/1.1",
        "GET /? HTTP/1.1",
        "GET / HTTP/1.0",
        "HEAD /x HTTP/1.1",
        "GET http://there/ HTTP/1.1",
        "GET / HTTP/2.0",
    ]
)


@given(st.lists(st.tuples(LINES, BLOCKS), min_size=1, max_size=6))
def test_what_came_before_changes_nothing(heads: list[tuple[str, str]]) -> None:
    """A parser that has read other heads reads the next one as a new parser does."""
    parser = HeadParser(1024)
    for line, block in heads:
        head = f"{line}\r\n{block}".encode()
        found = outcome(parser, head)
        assert found == outcome(HeadParser(1024), head)
        if isinstance(found, tuple):
            return  # its connection is over


@given(st.sampled_from(["GET", "HEAD", "POST"]), st.none() | st.just("q"), FIELDS)
@example("GET", None, [("Accept-Encoding", "br, zstd;q=0.5")])
@example("GET", None, [("If-None-Match", "*")])
@example("GET", None, [("RANGE", "bytes=0-")])
@example("GET", None, [("If-Match", "x")])
@example("GET", None, [("If-Range", "x")])
def test_plain_is_who_gets_all_of_it_as_it_lies(
    method: str, query: str | None, fields: list[tuple[str, str]]
) -> None:
    target = "/x" if query is None else f"/x?{query}"
    lines = [f"{method} {target} HTTP/1.1", "Host: h", *(f"{n}: {v}" for n, v in fields)]
    request = parse("\r\n".join(lines).encode("latin-1"))
    choosing = {"range", "if-range", "if-match", "if-none-match"}
    coded = any(n.lower() == "accept-encoding" and "zstd" in v for n, v in fields)
    chooses = coded or any(name.lower() in choosing for name, _ in fields)
    assert request.is_plain == (method == "GET" and query is None and not chooses)


@pytest.mark.parametrize("name", ["Host", "Content-Length", "Transfer-Encoding"])
def test_what_must_be_said_once_is_not_taken_twice(name: str) -> None:
    with pytest.raises(RequestError, match=f"the field {name.lower()} twice"):
        parse(f"GET / HTTP/1.1\r\n{name}: 1\r\nX: y\r\n{name.upper()}: 1".encode())


def test_fields_of_one_name_are_one_list() -> None:
    request = parse(b'GET / HTTP/1.1\r\nHost: h\r\nIf-None-Match: "a"\r\nif-none-match: "b"')
    assert request.fields["if-none-match"] == '"a", "b"'


@pytest.mark.parametrize(
    ("line", "status"),
    [
        ("GET / HTTP/2.0", 505),
        ("PRI * HTTP/2.0", 505),
        ("GET / HTTP/0.9", 505),
        ("GET / HTTP/3", 505),
        ("GET / HTTP/1.1x", 400),
        ("GET / HTTP/11", 400),
        ("GET /", 400),
        ("GET  / HTTP/1.1", 400),
        ("GET * HTTP/1.1", 400),
        ("GET /a#b HTTP/1.1", 400),
        ("GET http://u@h/ HTTP/1.1", 400),
        ("GET /" + "a" * MAX_LINE_BYTES + " HTTP/1.1", 414),
    ],
)
def test_lines_that_are_not_taken(line: str, status: int) -> None:
    with pytest.raises(RequestError) as caught:
        parse(f"{line}\r\nHost: h".encode())
    assert caught.value.status == status


def test_connection_says_who_stays() -> None:
    for version, value, stays in (
        ("1.1", "", True),
        ("1.1", "close", False),
        ("1.1", "Upgrade, CLOSE", False),
        ("1.0", "", False),
        ("1.0", "Keep-Alive", True),
    ):
        head = f"GET / HTTP/{version}\r\nHost: h\r\nConnection: {value}"
        request = parse(head.encode())
        assert request.keep_alive == stays
        assert request.chunks == (version == "1.1")


def test_the_longest_head_is_taken_and_no_longer_one() -> None:
    fields = [f"X{n}: y" for n in range(MAX_FIELDS)]
    for count, taken in ((MAX_FIELDS - 1, True), (MAX_FIELDS, False)):
        head = "\r\n".join(["GET / HTTP/1.1", "Host: h", *fields[:count]]).encode()
        assert isinstance(outcome(HeadParser(0), head), Request) == taken


@given(st.integers(0, 3000))
def test_bodies_are_bounded(length: int) -> None:
    head = f"POST / HTTP/1.1\r\nHost: h\r\nContent-Length: {length}".encode()
    found = outcome(HeadParser(1024), head)
    assert isinstance(found, Request) == (length <= 1024)
    assert isinstance(found, tuple) or found.body_bytes == length
    assume(length > 1024)
    assert isinstance(found, tuple)
    assert found[0] == 413
