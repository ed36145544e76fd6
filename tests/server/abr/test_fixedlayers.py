"""A fixed number of layers, except where the server allows fewer."""

from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st

from server.abr.decisioncontext import FixedLayers, Send, SendKeyframes, SendSlices
from server.abr.link import Link, LinkStep
from server.abr.session import PlaySession, SessionConfig
from server.study.simulator import simulate
from tests.support.delivery.media import MadeMedia, sizes_of

MEDIA = MadeMedia((sizes_of((8e3, 2e3, 3e3), (25.0, 1.0, 1.0)),), num_frames=100, segment_frames=30)
FAST = Link([LinkStep(1.0, 50e6, 0.02)])


@given(st.integers(1, 5), st.integers(0, 99))
def test_a_fixed_number_of_layers_stays(num_layers: int, first_frame: int) -> None:
    result = simulate(MEDIA, FixedLayers(num_layers), FAST, first_frame=first_frame)
    keyframes, *slices = [arrival.what for arrival in result.arrivals]
    first, layers = first_frame - first_frame % 30, min(3, num_layers)
    assert keyframes == SendKeyframes(first, 0, layers)
    births = list[int]()
    for send in slices:
        assert isinstance(send, SendSlices)
        assert (send.first_layer, send.end_layer) == (0, layers)
        births += send.births
    assert births == list(range(first + 1, 100))


def test_what_is_sent_at_once_fits_a_run_of_the_link() -> None:
    result = simulate(MEDIA, FixedLayers(3), FAST)
    lengths = [len(a.what.births) for a in result.arrivals if isinstance(a.what, SendSlices)]
    assert 1 < max(lengths) <= 0.02 * 50e6 / 8 / 13e3 * 1.2


def test_layers_that_the_server_takes_come_back_at_a_segment() -> None:
    session = PlaySession(MEDIA, FixedLayers(3), SessionConfig(), 0.0, rate_bps=1e6)
    sent = list[Send]()
    while session.holding.end_frame < 100:
        session.max_layers = 2 if 10 <= session.holding.end_frame < 40 else 3
        decision = session.decide(0.0)
        assert isinstance(decision, Send)
        session.sent(decision, 100.0, 0.0)
        session.acknowledge(0.0, session.sent_bytes)
        sent.append(decision)
    assert [s for s in sent if isinstance(s, SendKeyframes)] == [
        SendKeyframes(0, 0, 3),
        SendKeyframes(60, 2, 3),
    ]
    layers = {b: s.end_layer for s in sent if isinstance(s, SendSlices) for b in s.births}
    changes = [birth for birth in layers if layers[birth] != layers.get(birth - 1)]
    assert [(birth, layers[birth]) for birth in changes] == [(1, 3), (10, 2), (61, 3)]
    # The slice of the frame is sent before the keyframe.
    assert sent[sent.index(SendKeyframes(60, 2, 3)) - 1].births.stop == 61  # type: ignore[union-attr]
