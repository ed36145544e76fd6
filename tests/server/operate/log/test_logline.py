"""Lines of the log: one line for each event, and it can be parsed."""

from __future__ import annotations

import json

from hypothesis import given
from hypothesis import strategies as st

from server.operate.log.logline import MAX_LINE_BYTES, LineFormatter, LogStyle, Value

FORMATTERS = JSON, PLAIN = LineFormatter(LogStyle.JSON), LineFormatter(LogStyle.PLAIN)


def line(formatter: LineFormatter, event: str, **fields: Value) -> str:
    return formatter.line(1_800_000_000.25, "info", event, fields)


def test_a_request_is_one_line_of_either_style() -> None:
    fields: dict[str, Value] = {"path": "/v1/a b", "status": 200, "seconds": 0.12345678, "x": None}
    assert line(PLAIN, "request", **fields, kept=True) == (
        '2027-01-15T08:00:00.250Z info request path="/v1/a b" status=200 seconds=0.123457 kept=true'
    )
    assert line(JSON, "request", **fields, kept=True) == (
        '{"time":"2027-01-15T08:00:00.250Z","level":"info","event":"request","path":"/v1/a b",'
        '"status":200,"seconds":0.123457,"kept":true}'
    )
    assert json.loads(line(JSON, "ready"))["event"] == "ready"
    assert line(PLAIN, "ready").endswith("Z info ready")


values = st.one_of(
    st.text(st.characters(), max_size=700),
    st.text(st.sampled_from('\n\r\x1b\x7f\x85\u2028\ud800 ="\\a'), max_size=40),
    st.integers(),
    st.floats(),
    st.booleans(),
    st.none(),
)
fields = st.dictionaries(st.sampled_from(["path", "traceback", "status", "note"]), values)


@given(fields)
def test_whatever_a_field_holds_the_line_is_one_and_printable(fields: dict[str, Value]) -> None:
    for formatter in FORMATTERS:
        text = line(formatter, "request", **fields)
        assert all(0x20 <= ord(one) < 0x7F for one in text)
        assert len(text) <= MAX_LINE_BYTES
    told = json.loads(line(JSON, "request", **fields))
    for key, value in fields.items():
        if isinstance(value, int) or (isinstance(value, str) and len(value) <= 48):
            assert told[key] == value


@given(st.text(st.characters(), max_size=60), st.text(max_size=60))
def test_nobody_can_forge_a_key_in_plain_text(path: str, agent: str) -> None:
    """Outside quotes, each = is one of ours."""
    rest = line(PLAIN, "request", path=path, agent=agent).split(" request ", 1)[1]
    found = {}
    while rest:
        key, rest = rest.split("=", 1)
        if rest.startswith('"'):
            found[key], end = json.JSONDecoder().raw_decode(rest)
            rest = rest[end:].removeprefix(" ")
        else:
            found[key], _, rest = rest.partition(" ")
    assert found == {"path": path, "agent": agent}


def test_long_fields_are_cut_at_their_end_and_a_traceback_at_its_beginning() -> None:
    told = json.loads(line(JSON, "x", path="p" * 9000, traceback="t" * 9000 + "KeyError"))
    assert (len(told["path"]), len(told["traceback"])) == (512, 3000)
    assert told["path"].endswith("p...")
    assert told["traceback"].startswith("...t")
    assert told["traceback"].endswith("tKeyError")
    # Characters of six bytes each: more is cut off, so that a pipe accepts the line in one piece.
    told = json.loads(line(JSON, "x", path="\x01" * 9000, traceback="\x01" * 9000))
    assert (len(told["path"]), len(told["traceback"])) == (48, 384)
