"""Heads of responses: every field stays on its line."""

from __future__ import annotations

from email.utils import parsedate_to_datetime

from hypothesis import example, given
from hypothesis import strategies as st

from server.exchange.response import (
    HeadWriter,
    Response,
    error_response,
    fields_text,
    json_response,
)

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
    assert Response(200, {}, b"abc").head_fields() == b"Content-Length: 3\r\n"
    assert Response(200, {}, length=7).head_fields() == b"Content-Length: 7\r\n"
    assert Response(204).head_fields() == Response(304).head_fields() == b""


def test_json_is_one_line_whatever_it_says() -> None:
    response = error_response(400, 'a "b"\n\r\u2028\x00<script>', {"Allow": "GET"})
    assert b"\n" not in response.body
    assert response.fields["Cache-Control"] == "no-store"
    assert response.fields["Allow"] == "GET"
    assert json_response([1]).body == b"[1]"
