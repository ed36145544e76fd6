"""A session from outside: live streams, ends, full clients and data in flight."""

from __future__ import annotations

from dataclasses import replace

import pytest

from codec.errors import InvalidError
from server.abr.decisioncontext import Send, SendSlices, SendSnapshots
from server.abr.fixedlayers import FixedLayers
from server.abr.session import (
    Decision,
    Finished,
    PlaySession,
    SessionConfig,
    WaitForAck,
    WaitForFrames,
    WaitUntil,
)
from server.abr.sweep import Sweep
from tests.support.delivery.media import basketball_media

CONFIG = SessionConfig()
RATE_BPS = 50e6


def run(session: PlaySession, now_s: float) -> tuple[list[SendSlices | SendSnapshots], Decision]:
    """Sends everything that the session decides at `now_s`, over an instant link; returns it, and
    the decision that ended it."""
    sent: list[SendSlices | SendSnapshots] = []
    while True:
        session.acknowledge(now_s, session.sent_bytes)
        decision = session.decide(now_s)
        if not isinstance(decision, SendSlices | SendSnapshots):
            return sent, decision
        session.sent(decision, 1000.0, now_s)
        sent.append(decision)


def test_a_live_stream_is_waited_for_and_then_ends() -> None:
    live = replace(basketball_media(20), live=True, num_frames=0)
    session = PlaySession(live, Sweep(), CONFIG, 0.0, rate_bps=RATE_BPS)
    assert session.decide(0.0) == WaitForFrames()
    live.num_frames = 10
    sent, decision = run(session, 0.1)
    assert sent
    assert decision == WaitForFrames()
    assert session.holding.end_frame == 10
    live.num_frames, live.live = 20, False
    _, decision = run(session, 0.2)
    assert decision == Finished()
    assert session.holding.is_complete(0, 20)


@pytest.mark.parametrize("layers", [None, 2])
def test_a_part_of_a_stream(layers: int | None) -> None:
    media = basketball_media(60)
    policy = Sweep() if layers is None else FixedLayers(layers)
    session = PlaySession(media, policy, CONFIG, 0.0, 35, 40, RATE_BPS)
    sent, decision = run(session, 0.0)
    assert decision == Finished()
    births = [birth for send in sent if isinstance(send, SendSlices) for birth in send.births]
    assert max(births) == 39
    assert min(births) == 31
    snapshots = [send for send in sent if isinstance(send, SendSnapshots)]
    assert all(send.frame == 30 for send in snapshots)
    most = max(send.end_layer for send in sent)
    assert most == (layers or 4)


def test_a_full_client_rests_until_it_has_shown_some() -> None:
    media = basketball_media(900)
    session = PlaySession(media, Sweep(), CONFIG, 0.0)
    _, decision = run(session, 0.0)
    assert isinstance(decision, WaitUntil)
    lead_s = session.holding.end_frame / media.fps
    assert lead_s == pytest.approx(CONFIG.max_lead_s, abs=0.1)
    now_s, rests = 0.0, 0
    while session.holding.end_frame < 400:
        now_s += 1 / media.fps
        sent, _ = run(session, now_s)
        rests += not sent
        assert session.holding.end_frame / media.fps - now_s <= CONFIG.max_lead_s + 0.05
    assert rests > 50  # bursts are separated by rests


def test_no_more_is_under_way_than_a_moment_of_the_link() -> None:
    media = basketball_media(900)
    session = PlaySession(media, Sweep(), CONFIG, 0.0)
    while isinstance(decision := session.decide(0.0), Send):
        session.sent(decision, 9_000.0, 0.0)
    assert decision == WaitForAck()
    assert session.queued_bytes < CONFIG.first_bytes + 9_000
    # 8 Mbit/s from now on.
    now_s = 0.0
    for _ in range(200):
        now_s += 0.005
        session.acknowledge(now_s, min(session.sent_bytes, session.acked_bytes + 5_000))
        while isinstance(decision := session.decide(now_s), Send):
            session.sent(decision, 9_000.0, now_s)
    assert session.rate_bps == pytest.approx(8e6, rel=0.05)
    assert session.queued_bytes * 8 / 8e6 <= 0.25


def test_what_is_known_of_a_link_is_a_beginning() -> None:
    media = basketball_media(900)

    def first_burst(rate_bps: float | None) -> float:
        session = PlaySession(media, Sweep(), CONFIG, 0.0, rate_bps=rate_bps)
        while isinstance(decision := session.decide(0.0), Send):
            session.sent(decision, 9_000.0, 0.0)
        return session.queued_bytes

    assert first_burst(50e6) > 4 * first_burst(None)


@pytest.mark.parametrize(
    "name", ["max_lead_s", "queue_s", "run_s", "rest_s", "told_s", "first_rate_bps", "first_bytes"]
)
def test_settings_that_cannot_work_are_refused(name: str) -> None:
    with pytest.raises(InvalidError, match=name):
        SessionConfig(**{name: 0})  # type: ignore[arg-type]
