"""Heads of responses: every field stays on its line."""

from __future__ import annotations

from hypothesis import example, given
from hypothesis import strategies as st

from server.exchange.response import error_response, fields_text

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
