"""Queries of /play: a valid query, or a 400 with one line."""

from __future__ import annotations

from urllib.parse import parse_qsl

import pytest
from hypothesis import given
from hypothesis import strategies as st

from server.answers.asked import parse_query
from server.http.errors import RequestError

pairs = st.lists(
    st.tuples(
        st.sampled_from(["from", "until", "layers", "x"]),
        st.sampled_from(["auto", "all", "0", "1", "4", "5", "9", "10", "-1", "1.0", "٣", ""])
        | st.text(max_size=12),
    ),
    max_size=4,
)


@given(pairs)
def test_a_query_is_valid_or_a_400_in_one_short_line(items: list[tuple[str, str]]) -> None:
    try:
        query = parse_query(items, num_frames=10, live=False, num_layers=4)
    except RequestError as error:
        refused = error
    else:
        assert 0 <= query.from_frame < 10
        assert query.until_frame is None or query.until_frame > query.from_frame
        assert query.num_layers in (None, 1, 2, 3, 4)
        assert len(dict(items)) == len(items)
        return
    assert refused.status == 400
    assert len(str(refused)) < 200
    assert "\n" not in str(refused)


@pytest.mark.parametrize(
    "query",
    ["from=23", "from=-1", "from=x", "from=", "from=1e3", "from=99999999999", "layers=0",
     "layers=5", "layers=every", "until=0", "from=5&until=5", "from=1&from=2", "speed=2"],
)  # fmt: skip
def test_a_wrong_query_is_a_400(query: str) -> None:
    with pytest.raises(RequestError) as caught:
        parse_query(parse_qsl(query, keep_blank_values=True), 23, False, 4)
    assert caught.value.status == 400


def test_a_live_stream_may_be_joined_empty_but_a_finished_one_not() -> None:
    assert parse_query([], 0, True, 4).from_frame == 0
    with pytest.raises(RequestError, match="has 0 frames"):
        parse_query([], 0, False, 4)
    with pytest.raises(RequestError, match="has 0 frames"):
        parse_query([("from", "1")], 0, True, 4)
