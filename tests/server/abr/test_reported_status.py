"""Use of client status by a session: plausible reports are believed, others do no harm."""

from __future__ import annotations

from itertools import pairwise

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from server.abr.clientstatus import ClientStatus
from server.abr.decisioncontext import DecisionContext, Policy, Send, SendKeyframes, SendSlices
from server.abr.holding import Holding
from server.abr.playout import PlayoutClock, PlayoutConfig
from server.abr.session import Finished, PlaySession, SessionConfig, WaitUntil
from server.abr.sweep import Sweep
from tests.support.delivery.media import basketball_media

CONFIG = SessionConfig()
FPS = 30.0
LEAD = round(CONFIG.max_lead_s * FPS)

steps_s = st.floats(0, 0.4)
told_frames = st.integers(0, 60) | st.sampled_from([0, 10**6, 2**31 - 1])


@given(
    st.integers(0, 20),
    st.lists(st.tuples(steps_s, st.integers(0, 60), st.none() | told_frames), max_size=40),
)
@settings(max_examples=60)
def test_a_clock_that_is_told_goes_on_from_there_but_never_past_what_came(
    first: int, events: list[tuple[float, int, int | None]]
) -> None:
    clock = PlayoutClock(first, 10.0, PlayoutConfig(start_lead_s=0.2))
    now_s = 0.0
    for step_s, ready, frame in events:
        now_s += step_s
        end = clock.end_frame
        if frame is None:
            clock.ready_until(ready, now_s)
            assert clock.end_frame == max(end, ready)
        else:
            clock.set_next_frame(frame, now_s)
            assert clock.end_frame == end
            if clock.started_s is not None:
                assert clock.next_frame(now_s) == min(max(frame, first), end)
        shown = clock.next_frame(now_s)
        assert first <= shown <= clock.end_frame
        assert clock.stalled_s >= 0
        if clock.started_s is not None:
            assert clock.due_s(shown + 1) == pytest.approx(clock.due_s(shown) + 0.1)
            assert clock.times_s(shown)[1] == pytest.approx(clock.due_s(shown))
        clock.forget(shown)
        assert len(clock._bases) <= 3


def test_a_frame_before_the_first_puts_it_off() -> None:
    clock = PlayoutClock(100, 10.0, PlayoutConfig(start_lead_s=0))
    clock.ready_until(120, 1.0)
    clock.set_next_frame(70, 2.0)
    assert clock.next_frame(4.9) == 100
    assert clock.due_s(100) == pytest.approx(5.0)
    assert [clock.early_frames(now_s) for now_s in (2.0, 4.0, 5.0, 6.0)] == [30, 10, 0, 0]
    nothing_here = PlayoutClock(100, 10.0)
    nothing_here.set_next_frame(70, 2.0)
    assert nothing_here.early_frames(2.0) == 30
    assert nothing_here.end_frame == 100


def test_who_comes_back_with_frames_in_hand_is_sent_no_whole_lead_beyond_them() -> None:
    """It would be layer 0 of the whole lead, and no upper layers if the connection breaks again."""
    media = basketball_media(900)
    session = PlaySession(media, Sweep(), CONFIG, 0.0, first_frame=300, rate_bps=1e9)
    session.on_status(0.0, ClientStatus(300 - LEAD + 30))
    layers: dict[int, int] = {}
    for step in range(100):
        now_s = step / 100
        while isinstance(decision := session.decide(now_s), Send):
            births = decision.births if isinstance(decision, SendSlices) else range(0)
            session.sent(decision, 9_000.0 * max(1, len(births)), now_s)
            session.acknowledge(now_s, session.sent_bytes)
            for birth in births:
                layers[birth] = max(layers.get(birth, 0), decision.end_layer)
    # One second of the lead was free, another one has passed; some frames may still be missing.
    assert max(layers) < 300 + 60 + 30
    assert min(layers[birth] for birth in range(301, 350)) == media.num_layers


def test_a_clock_that_has_not_begun_begins_where_it_is_told() -> None:
    clock = PlayoutClock(0, 10.0, PlayoutConfig(start_lead_s=1.0))
    clock.ready_until(5, 1.0)
    clock.set_next_frame(0, 2.0)
    assert clock.started_s is None
    clock.set_next_frame(3, 2.0)
    assert clock.started_s == 2.0
    assert clock.next_frame(2.1) == 4


class ForwardPolicy:
    """Forwards to another policy; asserts that it is never asked about forgotten frames."""

    mends = True

    def __init__(self, policy: Policy) -> None:
        self._policy = policy
        self._frame = 0

    def choose(self, context: DecisionContext) -> Send | None:
        assert context.next_frame >= self._frame
        self._frame = context.next_frame
        return self._policy.choose(context)


acked_shares = st.floats(0, 1)
statuses = st.builds(
    ClientStatus, told_frames, st.floats(0, 100), st.booleans(), st.booleans()
) | st.builds(ClientStatus, st.none(), st.floats(0, 86_400), st.booleans(), st.booleans())


@given(st.lists(st.tuples(steps_s, acked_shares, st.none() | statuses), max_size=25))
@settings(max_examples=20, deadline=None)
def test_whatever_is_told_each_packet_goes_once_and_within_the_lead(
    events: list[tuple[float, float, ClientStatus | None]],
) -> None:
    media = basketball_media(9000)
    session = PlaySession(media, ForwardPolicy(Sweep()), CONFIG, 0.0)
    came = Holding(media, 0)
    underway: list[tuple[float, SendSlices | SendKeyframes]] = []
    seen: set[tuple[int, int]] = set()
    now_s = 0.0
    for step_s, share, status in events:
        now_s += step_s
        session.acknowledge(now_s, session.acked_bytes + share * session.queued_bytes)
        while underway and underway[0][0] <= session.acked_bytes + 0.5:
            underway.pop(0)[1].add_to(came)
        if status is not None:
            session.on_status(now_s, status)
        shown = session.clock.next_frame(now_s)
        assert shown <= session.clock.end_frame <= came.end_frame
        decision = session.decide(now_s)
        while isinstance(decision, SendSlices | SendKeyframes):
            if isinstance(decision, SendSlices):
                assert max(decision.births) < shown + LEAD
                for birth in decision.births:
                    layers = range(decision.first_layer, decision.end_layer)
                    assert not seen & {(birth, layer) for layer in layers}
                    seen |= {(birth, layer) for layer in layers}
            session.sent(decision, 5_000.0, now_s)
            underway.append((session.sent_bytes, decision))
            decision = session.decide(now_s)
        if isinstance(decision, WaitUntil):
            assert now_s < decision.time_s <= now_s + max(1 / FPS, CONFIG.rest_s) + 1e-9
        assert not isinstance(decision, Finished)


def run_until(session: PlaySession, from_s: float, until_s: float) -> list[float]:
    """Runs a session over an instant link, from wait to wait; returns the times of sends."""
    now_s, bursts_s = from_s, list[float]()
    while True:
        session.acknowledge(now_s, session.sent_bytes)
        decision = session.decide(now_s)
        if isinstance(decision, SendSlices | SendKeyframes):
            session.sent(decision, 1000.0, now_s)
            if bursts_s[-1:] != [now_s]:
                bursts_s.append(now_s)
            continue
        assert isinstance(decision, WaitUntil)
        if now_s >= until_s:
            return bursts_s
        now_s = min(decision.time_s, until_s)


def played(until_s: float = 3.0, rest_share: float = 0.0) -> PlaySession:
    media = basketball_media(3000)
    session = PlaySession(media, Sweep(), CONFIG, 0.0, rest_share=rest_share)
    run_until(session, 0.0, until_s)
    assert session.next_frame == round(until_s * FPS)
    return session


def test_a_paused_client_is_sent_no_more_than_its_lead() -> None:
    session = played()
    now_s = 3.0
    while now_s < 20:
        session.on_status(now_s, ClientStatus(80, paused=True))
        run_until(session, now_s, now_s + 1)
        now_s += 1
        assert session.next_frame == 80
    # Sends before the report assumed frame 90.
    assert session.holding.end_frame <= 90 + LEAD
    session.on_status(now_s, ClientStatus(80))
    run_until(session, now_s, now_s + 10)
    assert session.next_frame == 80 + 300
    assert session.holding.end_frame > 80 + 300 + 0.9 * LEAD


def test_a_client_that_falls_silent_in_a_pause_is_taken_to_go_on() -> None:
    session = played()
    session.on_status(3.0, ClientStatus(90, paused=True))
    run_until(session, 3.0, 7.9)
    assert session.next_frame == 90
    run_until(session, 7.9, 10.0)
    assert session.next_frame == pytest.approx(90 + 2 * FPS, abs=0.2 * FPS)


@pytest.mark.parametrize(
    ("status", "frame"),
    [
        (ClientStatus(30), 30),
        (ClientStatus(92), 90),  # nearly known
        (ClientStatus(200), 200),
        (ClientStatus(0, buffer_s=1.0), 0),
        (ClientStatus(10**6), None),
        (ClientStatus(buffer_s=2.0), -60),
        (ClientStatus(buffer_s=0.0), None),
        (ClientStatus(buffer_s=86_400), 0),
    ],
)
def test_a_client_is_where_it_says_if_that_has_come(
    status: ClientStatus, frame: int | None
) -> None:
    session = played()
    end_frame = session.holding.end_frame
    session.on_status(3.0, status)
    run_until(session, 3.0, 3.0)
    expected = end_frame + (frame or 0) if frame is None or frame < 0 else frame
    assert session.next_frame == expected


@pytest.mark.parametrize("tells", [True, False])
def test_a_client_that_does_not_read_is_not_a_slow_link(tells: bool) -> None:
    media = basketball_media(900)
    session = PlaySession(media, Sweep(), CONFIG, 0.0)
    now_s = 0.0

    def go(until_s: float, bytes_a_look: float) -> None:
        nonlocal now_s
        while now_s < until_s:
            now_s += 0.005
            acked_bytes = min(session.sent_bytes, session.acked_bytes + bytes_a_look)
            session.acknowledge(now_s, acked_bytes)
            while isinstance(decision := session.decide(now_s), Send):
                session.sent(decision, 9_000.0, now_s)

    go(1.0, 5_000)  # 8 Mbit/s
    assert session.rate_bps == pytest.approx(8e6, rel=0.05)
    if tells:
        session.on_status(now_s, ClientStatus(20, busy=True))
    go(2.0, 0)
    if tells:
        session.on_status(now_s, ClientStatus(50))
    go(2.05, 5_000)
    assert session.rate_bps is not None
    assert (session.rate_bps > 7.5e6) == tells
    go(3.0, 2_500)  # from then on the clock counts again
    assert session.rate_bps == pytest.approx(4e6, rel=0.05)
    session.on_status(now_s, ClientStatus(50, busy=True))
    go(3.0 + CONFIG.told_s + 1, 1_250)  # also for a client that reports it only once
    assert session.rate_bps == pytest.approx(2e6, rel=0.05)


def test_clients_that_began_together_drift_apart() -> None:
    def bursts_s(rest_share: float) -> list[float]:
        return run_until(played(2.0, rest_share), 2.0, 20.0)

    one, other = bursts_s(0.1), bursts_s(0.7)
    assert bursts_s(0.1) == one  # nothing is random in a session
    apart_s = [b - a for a, b in zip(one, other, strict=False)]
    assert apart_s[-1] > 1.0
    assert all(after >= before - 1 / FPS for before, after in pairwise(apart_s))
