"""Targets and fields: any text gives a request or an error, and valid ones round-trip."""

from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st
from multidict import CIMultiDict

from server.exchange.request import Request, read_request

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
