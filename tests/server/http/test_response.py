"""Heads of responses: every field stays on its line."""

from __future__ import annotations

from email.utils import parsedate_to_datetime

import pytest
from hypothesis import given
from hypothesis import strategies as st

from server.http.response import (
    HeadWriter,
    Response,
    error_response,
    fields_text,
    json_response,
    whole_fields,
)


@given(st.dictionaries(st.text(max_size=8), st.text(max_size=20), max_size=4))
def test_no_field_breaks_out_of_its_line(fields: dict[str, str]) -> None:
    try:
        data = fields_text(fields)
    except ValueError:  # more than one line, or not latin-1
        return
    lines = data.split(b"\r\n")
    assert lines.pop() == b""
    assert len(lines) == len(fields)
    assert data.count(b"\n") == data.count(b"\r") == len(fields)


@pytest.mark.parametrize("value", ["a\r\nSet-Cookie: b", "a\nb", "a\rb", "\n", "\r\n\r\nbody"])
def test_a_value_of_two_lines_is_refused(value: str) -> None:
    for fields in ({"X": value}, {value: "x"}):
        with pytest.raises(ValueError, match="more than one line"):
            fields_text(fields)


@given(
    st.sampled_from([200, 206, 304, 404, 429]),
    st.booleans(),
    st.booleans(),
    st.floats(0, 4e9),
)
def test_a_head_says_who_stays_and_when_it_was(
    status: int, keep_alive: bool, modern: bool, now_s: float
) -> None:
    heads = HeadWriter({"X-Common": "yes"})
    for moment_s in (now_s, now_s, now_s + 1):
        head = heads.head(status, b"X-Own: 1\r\n", keep_alive, modern, moment_s).decode()
        assert head.endswith("\r\n\r\n")
        first, *lines = head[:-4].split("\r\n")
        fields = dict(line.split(": ", 1) for line in lines)
        assert first.startswith(f"HTTP/1.1 {status} ")
        assert (fields["X-Common"], fields["X-Own"]) == ("yes", "1")
        assert parsedate_to_datetime(fields["Date"]).timestamp() == int(moment_s)
        said = fields.get("Connection", "")
        assert said == ("close" if not keep_alive else "" if modern else "keep-alive")


def test_lengths_are_said_where_there_may_be_a_body() -> None:
    assert whole_fields(Response(200, {}, b"abc")) == b"Content-Length: 3\r\n"
    assert whole_fields(Response(200, {}, length=7)) == b"Content-Length: 7\r\n"
    assert whole_fields(Response(204)) == whole_fields(Response(304)) == b""


def test_json_is_one_line_whatever_it_says() -> None:
    response = error_response(400, 'a "b"\n\r\u2028\x00<script>', {"Allow": "GET"})
    assert b"\n" not in response.body
    assert response.fields["Cache-Control"] == "no-store"
    assert response.fields["Allow"] == "GET"
    assert json_response([1]).body == b"[1]"
