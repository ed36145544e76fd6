"""Client status as JSON: it round-trips, and invalid input is one clear error."""

from __future__ import annotations

import json

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from codec.errors import InvalidError
from server.abr.clientstatus import MAX_BODY_BYTES, MAX_BUFFER_S, MAX_FRAME, ClientStatus

frames = st.integers(0, MAX_FRAME)
buffers_s = st.floats(0, MAX_BUFFER_S)
statuses = st.builds(ClientStatus, frames, buffers_s, st.booleans(), st.booleans())


@settings(max_examples=30)
@given(statuses | st.builds(ClientStatus, frames) | st.builds(ClientStatus, st.none(), buffers_s))
def test_what_is_written_is_read(status: ClientStatus) -> None:
    data = status.to_json()
    assert len(data) < MAX_BODY_BYTES / 4
    assert ClientStatus.from_json(data) == status


values = st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=3)
keys = st.sampled_from(["frame", "buffer_s", "paused", "busy", "Frame", ""])
objects = st.dictionaries(keys, values | st.lists(values, max_size=2), max_size=4)


@settings(max_examples=60)
@given(objects.map(lambda value: json.dumps(value).encode()) | st.binary(max_size=20))
def test_bytes_are_a_standing_or_one_line_that_says_why_not(data: bytes) -> None:
    try:
        status = ClientStatus.from_json(data)
    except InvalidError as error:
        refused = str(error)
    else:
        assert status.frame is not None or status.buffer_s is not None
        assert ClientStatus.from_json(status.to_json()) == status
        return
    assert 0 < len(refused) < 120
    assert "\n" not in refused


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "not JSON"),
        ("[" * 1000, "not JSON"),
        ("[1]", "not a JSON object"),
        ('{"paused": true}', "frame and buffer_s are both missing"),
        ('{"frame": -1}', "frame is not a whole number from 0"),
        ('{"frame": true}', "frame is not a whole number"),
        ('{"frame": "1"}', "frame is not a whole number"),
        ('{"frame": 2147483648}', "frame is not a whole number"),
        ('{"frame": null}', "frame is null; leave it out"),
        ('{"buffer_s": -0.1}', "buffer_s is not a number from 0"),
        ('{"buffer_s": NaN}', "buffer_s is not a number"),
        ('{"frame": 1, "busy": 1}', "busy is neither true nor false"),
        ('{"frame": 1, "seen": 1}', "unknown key 'seen'; the keys are frame, "),
        (" " * 1025, "more than 1024 bytes"),
    ],
)
def test_nonsense_is_named(text: str, message: str) -> None:
    with pytest.raises(InvalidError, match=message):
        ClientStatus.from_json(text.encode())


def test_text_that_is_not_utf_8_is_refused() -> None:
    with pytest.raises(InvalidError, match="not JSON in UTF-8"):
        ClientStatus.from_json('{"frame": 1}'.encode("utf-16"))
