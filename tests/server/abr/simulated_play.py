"""Plays over links that are made up: a session, and a client that reads as fast as its link."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field

from server.abr.policy import Policy
from server.abr.session import (
    Finished,
    PlaySession,
    SendSlice,
    SendSnapshots,
    SessionConfig,
    WaitForFrames,
    WaitUntil,
)

QUEUE_BYTES = 64 * 1024
FPS = 30.0


@dataclass
class FakeMedia:
    """A stream of equal slices."""

    num_frames: int = 300
    live: bool = False
    fps: float = FPS
    swin_size: int = 10
    segment_frames: int = 15
    layer_bytes: float = 8_000.0
    num_layers: int = 4
    has_slots: bool = False
    snapshot_layer_bytes: float = 100_000.0

    def snapshot_bytes(self, frame: int) -> tuple[float, ...]:
        return tuple(self.snapshot_layer_bytes * n for n in range(1, self.num_layers + 1))

    def slice_bytes(self, birth: int) -> tuple[float, ...]:
        return tuple(self.layer_bytes * n for n in range(1, self.num_layers + 1))

    def need_bps(self, num_layers: int) -> float:
        return 8 * num_layers * self.layer_bytes * self.fps


@dataclass
class Link:
    """Carries `rate_bps(now)`; takes `QUEUE_BYTES` at once, as a kernel does.

    What has left is acknowledged `round_trip_s` later.
    """

    rate_bps: Callable[[float], float]
    round_trip_s: float = 0.0
    queued_bytes: float = 0.0
    travelling: deque[tuple[float, float]] = field(default_factory=deque)  # due, bytes

    def pass_time(self, now_s: float, dt_s: float) -> None:
        gone_bytes = min(self.queued_bytes, self.rate_bps(now_s) * dt_s / 8)
        self.queued_bytes -= gone_bytes
        self.travelling.append((now_s + dt_s + self.round_trip_s, gone_bytes))
        while self.travelling and self.travelling[0][0] <= now_s + dt_s:
            self.travelling.popleft()

    @property
    def unacknowledged_bytes(self) -> int:
        return math.ceil(self.queued_bytes + sum(num_bytes for _, num_bytes in self.travelling))


@dataclass
class Log:
    """What a simulated play did."""

    decided: list[tuple[float, SendSlice]] = field(default_factory=list)
    sent: list[SendSlice | SendSnapshots] = field(default_factory=list)
    """All that was sent, in order."""
    arrived_s: dict[int, float] = field(default_factory=dict)
    """When the last byte of each slice had left the queue."""
    ended_s: float | None = None

    @property
    def layers(self) -> list[int]:
        return [send.num_layers for _, send in self.decided]

    def stall_s(self, first_frame: int, fps: float) -> float:
        """Seconds that a client stands still after its first picture."""
        start_s = self.arrived_s[first_frame]
        late_s = 0.0
        for birth, arrived_s in sorted(self.arrived_s.items()):
            if birth > first_frame:
                late_s = max(late_s, arrived_s - start_s - (birth - first_frame) / fps)
        return late_s


def steady(rate_bps: float) -> Callable[[float], float]:
    return lambda now_s: rate_bps


def simulate(
    media: FakeMedia,
    policy: Policy,
    rate_bps: Callable[[float], float],
    first_frame: int = 0,
    until_frame: int | None = None,
    for_s: float = 60.0,
    grow: Callable[[float], int] | None = None,
    config: SessionConfig | None = None,
    round_trip_s: float = 0.0,
) -> Log:
    """Plays `media` over a link of `rate_bps` in steps of 2 ms."""
    session = PlaySession(media, policy, config or SessionConfig(), 0.0, first_frame, until_frame)
    link, log, now_s, dt_s = Link(rate_bps, round_trip_s), Log(), 0.0, 0.002
    waiting: list[tuple[int, float]] = []  # birth, bytes in the queue up to its end
    resume_s = 0.0
    while now_s < for_s:
        if grow is not None:
            media.num_frames = grow(now_s)
        while link.queued_bytes <= QUEUE_BYTES and now_s >= resume_s and log.ended_s is None:
            match session.decide(now_s, link.unacknowledged_bytes):
                case SendSlice() as send:
                    log.decided.append((now_s, send))
                    log.sent.append(send)
                    num_bytes = int(media.slice_bytes(send.birth)[send.num_layers - 1])
                    session.sending(num_bytes, now_s, link.unacknowledged_bytes)
                    link.queued_bytes += num_bytes
                    waiting.append((send.birth, link.queued_bytes))
                case SendSnapshots() as send:
                    log.sent.append(send)
                    sizes = (0.0, *media.snapshot_bytes(send.frame))
                    num_bytes = int(sizes[send.num_layers] - sizes[send.first_layer])
                    session.sending(num_bytes, now_s, link.unacknowledged_bytes)
                    link.queued_bytes += num_bytes
                    waiting.append((send.frame, link.queued_bytes))
                case WaitUntil(time_s=time_s):
                    assert time_s > now_s
                    resume_s = time_s
                case WaitForFrames():
                    resume_s = now_s + 0.05
                case Finished():
                    log.ended_s = now_s
        before = link.queued_bytes
        link.pass_time(now_s, dt_s)
        now_s += dt_s
        waiting = [(birth, ahead - (before - link.queued_bytes)) for birth, ahead in waiting]
        for birth, ahead in waiting:
            if ahead <= 0.5:
                log.arrived_s.setdefault(birth, now_s)
        waiting = [(birth, ahead) for birth, ahead in waiting if ahead > 0.5]
        if log.ended_s is not None and not waiting:
            break
    return log
