"""A play in virtual time: the real session and policy, a link of a trace, and a client."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field

from server.abr.decisioncontext import Policy, Send, SendKeyframes, SendSlices
from server.abr.holding import Holding
from server.abr.link import Link
from server.abr.media import Media
from server.abr.playout import PlayoutClock
from server.abr.session import (
    Finished,
    PlaySession,
    SessionConfig,
    WaitForAck,
    WaitForFrames,
    WaitUntil,
)

PIECE_BYTES = 16 * 1024
"""Bytes after which a longer record is acknowledged in part."""


@dataclass(frozen=True, slots=True)
class Arrival:
    """Something has come whole."""

    time_s: float
    num_bytes: float
    what: Send


@dataclass(slots=True)
class Simulated:
    """The record of a simulated play."""

    arrivals: list[Arrival] = field(default_factory=list)
    estimates: list[tuple[float, float, float]] = field(default_factory=list)
    """(time, estimated rate in bit/s, unacknowledged bytes) at each decision to send."""
    ended_s: float = 0.0


@dataclass(frozen=True, slots=True)
class _Piece:
    """Bytes on their way."""

    comes_s: float
    num_bytes: float
    whole: Arrival | None
    """What has come whole with it."""


def send_bytes(media: Media, send: Send) -> float:
    """Bytes of `send` on the wire."""
    layers = range(send.first_layer, send.end_layer)
    if isinstance(send, SendKeyframes):
        return sum(media.sizes(send.frame).keyframe_bytes[layer] for layer in layers)
    return sum(media.sizes(birth).layer_bytes[layer] for birth in send.births for layer in layers)


def simulate(
    media: Media,
    policy: Policy,
    link: Link,
    config: SessionConfig | None = None,
    first_frame: int = 0,
    until_frame: int | None = None,
    at_most_s: float = 1e5,
) -> Simulated:
    """Plays `media` to its end, or for `at_most_s` seconds."""
    session = PlaySession(media, policy, config or SessionConfig(), 0.0, first_frame, until_frame)
    result = Simulated()
    underway: deque[_Piece] = deque()
    now_s = free_s = acked_bytes = 0.0
    while now_s < at_most_s:
        decision = session.decide(now_s)
        if isinstance(decision, SendSlices | SendKeyframes):
            num_bytes = send_bytes(media, decision)
            session.sent(decision, num_bytes, now_s)
            whole, left = None, num_bytes
            free_s = max(free_s, now_s)
            # What takes no bytes comes as well.
            while whole is None:
                piece = min(left, PIECE_BYTES)
                left -= piece
                free_s = link.passed_s(free_s, piece)
                comes_s = free_s + link.at(free_s).latency_s
                if underway:
                    comes_s = max(comes_s, underway[-1].comes_s)
                whole = None if left > 0 else Arrival(comes_s, num_bytes, decision)
                underway.append(_Piece(comes_s, piece, whole))
            result.estimates.append((now_s, session.rate_bps or 0.0, session.queued_bytes))
            continue
        until_s = at_most_s
        if isinstance(decision, Finished) and not underway:
            break
        if isinstance(decision, WaitUntil):
            until_s = decision.time_s
        elif isinstance(decision, WaitForFrames):
            until_s = now_s + 0.05
        elif isinstance(decision, WaitForAck):
            assert underway, "nothing is on its way, and the session waits for it"
        now_s = max(now_s, min(until_s, underway[0].comes_s) if underway else until_s)
        while underway and underway[0].comes_s <= now_s:
            one = underway.popleft()
            acked_bytes += one.num_bytes
            if one.whole is not None:
                result.arrivals.append(one.whole)
        session.acknowledge(now_s, acked_bytes)
    result.ended_s = now_s
    return result


@dataclass(frozen=True, slots=True)
class Shown:
    """A frame as the client showed it."""

    frame: int
    due_s: float
    shown_s: float
    layers: float
    psnr_db: float


def play_out(
    media: Media, result: Simulated, config: SessionConfig, first_frame: int, until_frame: int
) -> tuple[list[Shown], PlayoutClock]:
    """The frames shown by a client that receives `result`."""
    clock = PlayoutClock(first_frame, media.fps, config.playout, until_frame)
    ready = Holding(media, first_frame)
    # When each frame shows goes by layer 0 alone.
    for arrival in result.arrivals:
        arrival.what.add_to(ready)
        clock.ready_until(ready.end_frame, arrival.time_s)
    holding = Holding(media, first_frame)
    shown: list[Shown] = []
    arrivals, n = result.arrivals, 0
    if clock.started_s is None:
        return shown, clock
    for frame in range(first_frame, min(clock.end_frame, until_frame)):
        due_s, shown_s = clock.times_s(frame)
        while n < len(arrivals) and arrivals[n].time_s <= shown_s + 1e-9:
            arrivals[n].what.add_to(holding)
            n += 1
        shown.append(Shown(frame, due_s, shown_s, holding.layers(frame), holding.psnr_db(frame)))
        holding.forget(frame)
    return shown, clock
