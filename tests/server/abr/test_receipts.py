"""What a client says that it has received, as acknowledgements."""

from __future__ import annotations

from itertools import pairwise

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from server.abr.clientstatus import MAX_POINT
from server.abr.decisioncontext import FixedLayers, Send
from server.abr.receipts import Receipts
from server.abr.session import PlaySession, SessionConfig, WaitForAck
from tests.support.delivery.media import basketball_media

numbers = st.integers(0, 5000) | st.sampled_from([0, MAX_POINT])


@given(
    st.lists(
        st.tuples(
            st.floats(0, 2),
            st.integers(0, 900),
            st.lists(st.tuples(numbers, numbers), max_size=5),
        ),
        max_size=8,
    )
)
@settings(max_examples=60)
def test_whatever_is_said_nothing_comes_before_it_was_sent_nor_goes_back(
    events: list[tuple[float, int, list[tuple[int, int]]]],
) -> None:
    receipts, now_s, sent, found = Receipts(), 0.0, 0, [(float("-inf"), 0.0)]
    receipts.start_bytes = 50
    for step_s, num_bytes, points in events:
        now_s += step_s
        sent += num_bytes
        found += receipts.take(points, sent, now_s)
        assert receipts.came_bytes == found[-1][1] <= sent
        assert found[-1][0] <= now_s
    assert all(a[0] <= b[0] and a[1] < b[1] for a, b in pairwise(found))


def test_bytes_and_times_are_those_of_the_sender() -> None:
    receipts = Receipts()
    receipts.start_bytes = 50
    came = receipts.take([(1_000_000, 50), (1_000_200, 100), (1_000_300, 125)], 200, 7.4)
    # A report that was longer on its way says as well when things came.
    came += receipts.take([(1_000_600, 300)], 200, 8.0)
    times_s, found_bytes = zip(*came, strict=True)
    assert times_s == pytest.approx((7.3, 7.4, 7.7))
    assert list(found_bytes) == [50, 75, 200]


def test_a_link_that_turns_out_to_be_something_in_between_is_measured_anew() -> None:
    media = basketball_media(900)
    session = PlaySession(media, FixedLayers(4), SessionConfig(), 0.0)
    for step in range(1, 200):
        while isinstance(decision := session.decide(step / 1000), Send):
            session.sent(decision, 20_000, step / 1000)
            session.acknowledge(step / 1000 + 1e-5, session.sent_bytes - 5_000)
    assert session.rate_bps is not None
    assert session.rate_bps > 1e8
    session.doubt(0.2, 30_000)
    assert session.rate_bps is None
    assert session.queued_bytes == session.sent_bytes - 30_000
    assert isinstance(session.decide(0.2), WaitForAck)
    for step in range(1, 40):
        session.acknowledge(0.2 + step / 50, 30_000 + 5_000 * step)
    assert session.rate_bps == pytest.approx(8 * 5_000 * 50, rel=0.1)
