"""A session from outside: live streams, ends, full clients, bytes in flight, former failures."""

from __future__ import annotations

from dataclasses import replace

import pytest

from codec.errors import InvalidError
from server.abr.decisioncontext import FixedLayers, Send, SendKeyframes, SendSlices
from server.abr.link import Link, LinkStep
from server.abr.playout import PlayoutConfig
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
from server.study.simulator import play_out, simulate
from tests.support.delivery.media import MadeMedia, basketball_media, sizes_of

CONFIG = SessionConfig()
RATE_BPS = 50e6


def run(session: PlaySession, now_s: float) -> tuple[list[SendSlices | SendKeyframes], Decision]:
    """Sends everything that the session decides at `now_s`, over an instant link; returns it, and
    the decision that ended it."""
    sent: list[SendSlices | SendKeyframes] = []
    while True:
        session.acknowledge(now_s, session.sent_bytes)
        decision = session.decide(now_s)
        if not isinstance(decision, SendSlices | SendKeyframes):
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
    keyframes = [send for send in sent if isinstance(send, SendKeyframes)]
    assert all(send.frame == 30 for send in keyframes)
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


def test_a_play_begins_however_short_its_lead_may_be() -> None:
    # At 25 fps the client waits for three frames, but 0.1 s are two and a half.
    media = MadeMedia((sizes_of((2e3,), (25.0,)),), num_frames=20, fps=25.0)
    link = Link([LinkStep(1.0, 1e6, 0.01)])
    for config in (
        SessionConfig(max_lead_s=0.1),
        SessionConfig(max_lead_s=0.02, playout=PlayoutConfig(start_lead_s=0.5)),
    ):
        result = simulate(media, FixedLayers(1), link, config, at_most_s=30)
        assert len(play_out(media, result, config, 0, 20)[0]) == 20


@pytest.mark.parametrize("layer_bytes", [8426.3, 14657.87, 10_000.1, 9_999.9])
def test_parts_of_bytes_do_not_keep_an_idle_link_busy(layer_bytes: float) -> None:
    media = MadeMedia((sizes_of((layer_bytes,), (25.0,)),), num_frames=450, fps=25.0)
    rate_bps = 200 * 8 * layer_bytes
    link = Link([LinkStep(1.0, rate_bps, 0.02)])
    result = simulate(media, FixedLayers(1), link)
    # The lead is full after half a second; from then on the link rests most of the time.
    assert result.estimates[-1][1] == pytest.approx(rate_bps, rel=0.1)


@pytest.mark.parametrize("latency_s", [0.0, 0.02, 0.15, 0.4])
@pytest.mark.parametrize("num_layers", [1, 2])
def test_what_is_sent_little_by_little_does_not_make_a_link_slow(
    latency_s: float, num_layers: int
) -> None:
    # The lead is soon full, and further data needs a tenth or a half of the link.
    media = MadeMedia((sizes_of((10e3, 40e3), (25.0, 1.0)),), num_frames=450)
    rate_bps = 24e6
    link = Link([LinkStep(1.0, rate_bps, latency_s)])
    result = simulate(media, FixedLayers(num_layers), link)
    measured = [estimate for _, estimate, _ in result.estimates if estimate]
    assert len(measured) > 100
    assert measured == pytest.approx([rate_bps] * len(measured), rel=0.01)


def test_a_link_that_slows_down_during_a_rest_is_noticed() -> None:
    media = MadeMedia((sizes_of((20e3,), (25.0,)),), num_frames=900)
    link = Link([LinkStep(10.0, 48e6, 0.05), LinkStep(100.0, 6e6, 0.05)])
    result = simulate(media, FixedLayers(1), link)
    rates = {time_s: estimate for time_s, estimate, _ in result.estimates}
    assert rates[max(t for t in rates if t < 10)] == pytest.approx(48e6, rel=0.01)
    assert rates[max(t for t in rates if t < 11)] == pytest.approx(6e6, rel=0.02)


@pytest.mark.parametrize("latency_s", [0.02, 0.1, 0.3])
def test_a_link_that_recovers_is_noticed_however_little_is_underway(latency_s: float) -> None:
    # At first so few bytes may be in flight that the link pauses between packets.
    media = MadeMedia((sizes_of((10e3, 30e3), (25.0, 1.0)),), num_frames=450)
    link = Link([LinkStep(10.0, 0.5e6, latency_s), LinkStep(100.0, 20e6, latency_s)])
    result = simulate(media, FixedLayers(2), link)
    rates = {time_s: estimate for time_s, estimate, _ in result.estimates}
    assert rates[max(t for t in rates if t < 10)] == pytest.approx(0.5e6, rel=0.01)
    soon_s = 11.0 + 5 * latency_s
    assert rates[max(t for t in rates if t < soon_s)] == pytest.approx(20e6, rel=0.05)
