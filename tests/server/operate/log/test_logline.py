"""Lines of the log: one event, one line, and it can be read back."""

from __future__ import annotations

import json

from hypothesis import given
from hypothesis import strategies as st

from server.operate.log.logline import MAX_LINE_BYTES, LineFormat, LogStyle, Value

TIME_S = 1_800_000_000.25


def line(style: LogStyle, event: str, **fields: Value) -> str:
    return LineFormat(style).line(TIME_S, "info", event, fields).decode("ascii")


def test_a_request_is_one_line_of_either_style() -> None:
    fields: dict[str, Value] = {"path": "/v1/a b", "status": 200, "seconds": 0.12345678, "x": None}
    assert line(LogStyle.PLAIN, "request", **fields, kept=True) == (
        '2027-01-15T08:00:00.250Z info request path="/v1/a b" status=200 seconds=0.123457 '
        "kept=true\n"
    )
    assert json.loads(line(LogStyle.JSON, "request", **fields, kept=True)) == {
        "time": "2027-01-15T08:00:00.250Z",
        "level": "info",
        "event": "request",
        "path": "/v1/a b",
        "status": 200,
        "seconds": 0.123457,
        "kept": True,
    }
    assert json.loads(line(LogStyle.JSON, "ready"))["event"] == "ready"
    assert line(LogStyle.PLAIN, "ready").endswith("Z info ready\n")


def test_time_goes_on() -> None:
    lines = LineFormat(LogStyle.PLAIN)
    stamps = [lines.line(t, "info", "x", {})[:24] for t in (0.9994, 1.0, 1.0005, 61.25, 1.0)]
    assert stamps == [
        b"1970-01-01T00:00:00.999Z",
        b"1970-01-01T00:00:01.000Z",
        b"1970-01-01T00:00:01.000Z",
        b"1970-01-01T00:01:01.250Z",
        b"1970-01-01T00:00:01.000Z",
    ]


values = st.one_of(
    st.text(st.characters(), max_size=700),
    st.text(st.sampled_from('\n\r\x1b\x7f\x85\u2028\ud800 ="\\a'), max_size=40),
    st.integers(),
    st.floats(),
    st.booleans(),
    st.none(),
)


@given(st.dictionaries(st.sampled_from(["path", "agent", "status", "note"]), values))
def test_whatever_a_field_holds_the_line_is_one_and_printable(fields: dict[str, Value]) -> None:
    for style in LogStyle:
        data = LineFormat(style).line(TIME_S, "info", "request", fields)
        assert data[-1:] == b"\n"
        assert all(0x20 <= byte < 0x7F for byte in data[:-1])
        assert len(data) <= MAX_LINE_BYTES
    told = json.loads(line(LogStyle.JSON, "request", **fields))
    for key, value in fields.items():
        if isinstance(value, int) or (isinstance(value, str) and len(value) <= 48):
            assert told[key] == value


@given(st.text(st.characters(), max_size=60), st.text(max_size=60))
def test_nobody_can_forge_a_key_in_plain_text(path: str, agent: str) -> None:
    """Outside of quotes each = is one of ours."""
    text = line(LogStyle.PLAIN, "request", path=path, agent=agent)
    rest = text.split(" request ", 1)[1].rstrip("\n")
    found = {}
    while rest:
        key, rest = rest.split("=", 1)
        if rest.startswith('"'):
            found[key], end = json.JSONDecoder().raw_decode(rest)
            rest = rest[end:].removeprefix(" ")
        else:
            found[key], _, rest = rest.partition(" ")
    assert found == {"path": path, "agent": agent}


def test_long_fields_are_cut_and_a_traceback_less() -> None:
    told = json.loads(line(LogStyle.JSON, "x", path="p" * 9000, traceback="t" * 9000))
    assert (len(told["path"]), len(told["traceback"])) == (48, 8192)
    assert told["path"].endswith("...")
