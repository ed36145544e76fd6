"""Decides which packets one client is sent next, and when: the pure core, without sockets or clock.

Rule: late decisions. Only as much is in flight as the link carries in a moment, so the next
decision uses the newest state of the link and the client.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, field

from codec.errors import InvalidError
from codec.stream.manifest import MAX_LAYERS

from .clientstatus import ClientStatus
from .decisioncontext import DecisionContext, Policy, Send, SendSlices
from .estimator import EstimatorConfig, RateEstimator
from .holding import Holding
from .media import Media
from .playout import PlayoutClock, PlayoutConfig

STATUS_SLACK_S = 0.1
"""Seconds by which a status report may differ from the session's clock, beyond the link's latency,
without moving that clock."""


@dataclass(frozen=True, slots=True)
class SessionConfig:
    """Pacing of a play."""

    max_lead_s: float = 6.0
    """Maximum seconds of media sent ahead of the frame that the client shows."""
    queue_s: float = 0.1
    """Maximum unacknowledged data beyond the link's latency, in seconds at the estimated rate."""
    run_s: float = 0.02
    """Maximum data of one decision, in seconds at the link's rate; always at least one packet."""
    rest_s: float = 0.1
    """Seconds of media that a client with a full buffer shows before the server sends more: a burst
    measures the link, a trickle does not. A server lengthens it at random, up to double."""
    told_s: float = 5.0
    """Seconds for which a client's report that it is paused or busy holds, unless it repeats the
    report: the report that this is over may be lost."""
    first_rate_bps: float = 4e6
    """Assumed rate of the link before the first estimate, bits per second."""
    first_bytes: int = 32 * 1024
    """Maximum unacknowledged bytes at the start; it grows with each acknowledged byte."""
    playout: PlayoutConfig = field(default_factory=PlayoutConfig)
    """Assumed buffering of the client before it shows frames."""
    estimator: EstimatorConfig = field(default_factory=EstimatorConfig)

    def __post_init__(self) -> None:
        for name in (
            "max_lead_s",
            "queue_s",
            "run_s",
            "rest_s",
            "told_s",
            "first_rate_bps",
            "first_bytes",
        ):
            if not getattr(self, name) > 0:
                raise InvalidError(f"{name} is {getattr(self, name)}; it must be positive")

    def lead_frames(self, fps: float, most_s: float = math.inf) -> int:
        """How many frames may be sent ahead: as many as max_lead_s says, or `most_s` if that is
        less, and no fewer than a client waits for, which would wait for ever."""
        return max(self.playout.least_frames(fps), round(min(self.max_lead_s, most_s) * fps))


@dataclass(frozen=True, slots=True)
class WaitForAck:
    """Enough is on its way: ask again once more of it is acknowledged."""


@dataclass(frozen=True, slots=True)
class WaitUntil:
    """Nothing is worth sending before `time_s`, unless something is acknowledged."""

    time_s: float


@dataclass(frozen=True, slots=True)
class WaitForFrames:
    """All there is has been sent, but the stream is live: look for new frames."""


@dataclass(frozen=True, slots=True)
class Finished:
    """Nothing more will be sent."""


@dataclass(slots=True)
class _Underway:
    """Something that was sent, and is not acknowledged."""

    end_byte: float
    """Bytes that were sent with it, of all."""
    end_frame: int
    """The first frame that cannot show once it has come."""
    sent_s: float


Decision = Send | WaitForAck | WaitUntil | WaitForFrames | Finished


class PlaySession:
    """One play of `media`, from `first_frame` on, up to but without `until_frame`."""

    def __init__(
        self,
        media: Media,
        policy: Policy,
        config: SessionConfig,
        now_s: float,
        first_frame: int = 0,
        until_frame: int | None = None,
        rate_bps: float | None = None,
        rest_share: float = 0.0,
    ) -> None:
        """rate_bps: what is known of the link from an earlier play. rest_share: how much longer
        than rest_s this client rests, as a share of that; with a different share for each client,
        clients that began together do not burst in step."""
        self._media = media
        self._policy = policy
        self.max_layers = MAX_LAYERS
        """Layers that may be sent from now on."""
        self.max_lead_s = math.inf
        """Seconds of media that may be sent ahead, where that is less than config.max_lead_s."""
        self._config = config
        self._until_frame = until_frame
        self._estimator = RateEstimator(config.estimator)
        self._first_rate_bps = rate_bps or config.first_rate_bps
        self._known = rate_bps is not None
        self.holding = Holding(media, first_frame)
        self.clock = PlayoutClock(first_frame, media.fps, config.playout, self._last_frame())
        self.next_frame = first_frame
        """The first frame that the client had not shown at the last decision."""
        self._oldest_frame = first_frame  # what lies before is forgotten
        self._rest_s = config.rest_s * (1 + rest_share)
        self.sent_bytes = 0.0
        self.acked_bytes = 0.0
        self._acked_s = now_s
        self._came_s = now_s  # when something came last
        self._counted_s = now_s  # up to when time was counted, as busy or as idle
        self._begins = True  # whether the link had nothing to carry before what comes next
        self._underway: deque[_Underway] = deque()
        self._least_latency_s: float | None = None
        self.report_s = 0.0
        """How late an acknowledgement may be told: the time between two reports of a client that
        acknowledges by them; 0 where the kernel acknowledges."""
        self._resting = False
        self._paused_frame: int | None = None  # what a paused client will show next
        self._paused_until_s = -math.inf
        self._busy_until_s = -math.inf

    @property
    def rate_bps(self) -> float | None:
        """The estimated throughput to this client."""
        return self._estimator.rate_bps

    @property
    def least_latency_s(self) -> float | None:
        """The least time from the sending of a byte over an idle link to its acknowledgement."""
        return self._least_latency_s

    @property
    def lead_s(self) -> float:
        """Seconds of media that were sent ahead of what the client showed at the last decision."""
        return (self.holding.end_frame - self.next_frame) / self._media.fps

    @property
    def queued_bytes(self) -> float:
        """Sent, but not acknowledged; less than a byte is what adding up parts of bytes leaves."""
        queued_bytes = self.sent_bytes - self.acked_bytes
        return queued_bytes if queued_bytes >= 0.5 else 0.0

    def _last_frame(self) -> int | None:
        """The first frame that never comes; None while it is not known."""
        if self._until_frame is not None and (
            not self._media.live or self._until_frame <= self._media.num_frames
        ):
            return min(self._until_frame, self._media.num_frames)
        return None if self._media.live else self._media.num_frames

    def acknowledge(self, now_s: float, acked_bytes: float) -> None:
        """The client has `acked_bytes` of all sent bytes."""
        self._hold_clock(now_s)
        gone = acked_bytes - self.acked_bytes
        if self.queued_bytes > 0 and now_s >= self._busy_until_s:
            self._measure(now_s, gone)
        self.acked_bytes = max(self.acked_bytes, acked_bytes)
        self._acked_s = now_s
        self._came_s = now_s if gone > 0 else self._came_s
        while self._underway and self._underway[0].end_byte < self.acked_bytes + 0.5:
            self.clock.ready_until(self._underway.popleft().end_frame, now_s)

    def doubt(self, now_s: float, acked_bytes: float) -> None:
        """The client has only `acked_bytes`: what was acknowledged beyond them went to something
        that stands in between, and so nothing that was measured holds."""
        self.acked_bytes = min(self.acked_bytes, acked_bytes)
        self._acked_s = self._came_s = self._counted_s = now_s
        self._estimator = RateEstimator(self._config.estimator)
        self._known = False
        self._least_latency_s = None
        self._begins = True
        self._underway.clear()
        self._underway.append(_Underway(self.sent_bytes, self.holding.end_frame, now_s))

    def on_status(self, now_s: float, status: ClientStatus) -> None:
        """Applies a status report of the client, as far as it is plausible."""
        clock, frame = self.clock, status.frame
        if frame is None and status.buffer_s is not None:
            frame = clock.end_frame - round(status.buffer_s * clock.fps)
        # The report of a playing client is old when it arrives.
        slack_s = STATUS_SLACK_S + (self._least_latency_s or 0.0)
        if frame is not None and (
            status.paused or abs(frame - clock.next_frame(now_s)) > slack_s * clock.fps
        ):
            clock.set_next_frame(frame, now_s)
        self._paused_frame = clock.next_frame(now_s) if status.paused else None
        self._paused_until_s = until_s = now_s + self._config.told_s
        self._busy_until_s = until_s if status.busy else -math.inf

    def _hold_clock(self, now_s: float) -> None:
        """Keeps the clock of a paused client where it is."""
        if self._paused_frame is None:
            return
        if now_s < self._paused_until_s:
            self.clock.set_next_frame(self._paused_frame, now_s)
        else:
            self._paused_frame = None

    def _measure(self, now_s: float, gone_bytes: float) -> None:
        """Adds a sample, of the time in which the link had something to carry.

        The link was idle if the first byte underway could not have arrived by the last
        acknowledgement. Then the time to the first acknowledgement mixes the latency with the
        transfer of the acknowledged bytes, so the sample begins after it.
        """
        sent_s, since_s = self._underway[0].sent_s, self._acked_s
        if self._least_latency_s is None or sent_s + self._least_latency_s > since_s:
            self._begins = True
        if self._begins:
            if gone_bytes <= 0:
                return
            self._begins = False
            # A client's report may say of a byte that it came before this link was doubted.
            took_s = max(0.0, now_s - sent_s)
            self._least_latency_s = min(took_s, self._least_latency_s or took_s)
            # It carries at least what came since something came, pauses and all.
            since_s = self._came_s
            if 8 * gone_bytes <= (self.rate_bps or math.inf) * (now_s - since_s):
                return
        self._estimator.add(gone_bytes, now_s - since_s, max(0.0, since_s - self._counted_s))
        self._counted_s = now_s

    def sent(self, send: Send, num_bytes: float, now_s: float) -> None:
        """`send` went out, as `num_bytes` bytes."""
        send.add_to(self.holding)
        self.sent_bytes += num_bytes
        self._underway.append(_Underway(self.sent_bytes, self.holding.end_frame, now_s))

    def lost(self, num_bytes: float) -> None:
        """So many of the sent bytes will never arrive."""
        self.sent_bytes -= num_bytes
        for one in self._underway:
            one.end_byte = min(one.end_byte, self.sent_bytes)

    def sent_slices(self, send: SendSlices, num_bytes: Sequence[int], now_s: float) -> None:
        """`send` went out, slice after slice, with so many bytes each."""
        if send.first_layer:
            # No frame waits for these: whether they come one by one or together is all the same.
            self.sent(send, sum(num_bytes), now_s)
            return
        holding, underway = self.holding, self._underway
        for birth, size in zip(send.births, num_bytes, strict=True):
            holding.add(birth, 0, send.end_layer)
            self.sent_bytes += size
            underway.append(_Underway(self.sent_bytes, holding.end_frame, now_s))

    def decide(self, now_s: float) -> Decision:
        """The next action of the sender."""
        media, config, clock = self._media, self._config, self.clock
        self._hold_clock(now_s)
        last_frame = self._last_frame()
        if clock.until_frame != last_frame:
            clock.until_frame = last_frame
            clock.ready_until(clock.end_frame, now_s)  # a lead that never comes is not waited for
        if not media.num_frames:
            return WaitForFrames() if media.live else Finished()
        rate_bps = self._estimator.rate_bps
        if self.queued_bytes >= self._allowed_bytes(rate_bps):
            return WaitForAck()
        self.next_frame = next_frame = clock.next_frame(now_s)
        if last_frame is not None and next_frame >= last_frame:
            return Finished()
        clock.forget(next_frame)
        # A client that is further behind than it seemed gets no more of what was forgotten.
        self._oldest_frame = oldest_frame = max(self._oldest_frame, next_frame)
        self.holding.forget(oldest_frame)
        num_frames = media.num_frames if last_frame is None else last_frame
        # What a client has in hand from before is a part of its lead.
        lead_frames = config.lead_frames(media.fps, self.max_lead_s) - clock.early_frames(now_s)
        lead_frames = max(config.playout.least_frames(media.fps), lead_frames)
        end_birth = min(num_frames, next_frame + lead_frames)
        context = DecisionContext(
            media=media,
            holding=self.holding,
            clock=clock,
            now_s=now_s,
            rate_bps=rate_bps or self._first_rate_bps,
            measured=rate_bps is not None or self._known,
            queued_bytes=self.queued_bytes,
            latency_s=self._least_latency_s or 0.0,
            next_frame=oldest_frame,
            end_birth=end_birth,
            max_lead_s=config.max_lead_s,
            run_s=config.run_s,
            is_paused=self._paused_frame is not None,
            max_layers=self.max_layers,
        )
        full = end_birth < num_frames
        # A client that turned out to be further behind may hold more than the lead.
        shown = max(0, end_birth - self.holding.end_frame)
        rests_s = self._rest_s - shown / media.fps
        waits = clock.started_s is None or clock.stalled(now_s)
        if self._resting and full and rests_s > 0 and not waits:
            return WaitUntil(now_s + max(1 / media.fps, rests_s))
        send = self._policy.choose(context)
        self._resting = send is None
        if send is not None:
            return send
        if full:
            return WaitUntil(now_s + max(1 / media.fps, rests_s))
        if last_frame is None:
            return WaitForFrames()
        # What lacks may be worth sending later, as long as it shows.
        if self._policy.mends and not self.holding.is_complete(oldest_frame, last_frame):
            return WaitUntil(now_s + 1 / media.fps)
        return Finished()

    def _allowed_bytes(self, rate_bps: float | None) -> float:
        """How much may be on its way."""
        config = self._config
        if rate_bps is None:
            known = self._first_rate_bps * config.queue_s / 8 if self._known else 0.0
            return max(known, config.first_bytes + self.acked_bytes)
        latency_s = self._least_latency_s or 0.0
        held_s = config.queue_s + latency_s
        if self.report_s:
            # The next report is sent after this time, or once the last one is answered.
            held_s += max(self.report_s, latency_s)
        return max(config.first_bytes, rate_bps * held_s / 8)
