"""What one /play sends next, and when: the pure core, without sockets or clock.

Rule: the client is taken to show frames in real time from the moment that its first window has left
the server whole; a slice that comes late stops that clock until it is there.

Where slots last (format version 2) a slice changes what the client holds. So a layer that was left
out once is left out until a snapshot of it is sent, and that can be at a segment's first frame
only. A play begins with snapshots, too.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Protocol

from codec.errors import InvalidError

from .estimator import ThroughputEstimator
from .policy import Policy, Situation


@dataclass(frozen=True, slots=True)
class SessionConfig:
    """How far ahead of the client a play is kept."""

    target_lead_s: float = 2.0
    """Seconds of media sent ahead of what the client shows, at most."""
    burst_s: float = 0.5
    """Seconds of media sent in one go; a burst measures the link, a trickle cannot."""
    blind_lead_s: float = 0.25
    """Seconds of media sent ahead before anything is known of the link."""
    start_s: float = 0.5
    """Seconds within which the first picture should be complete, quality permitting."""
    poll_s: float = 0.02
    """Seconds between two looks at a send queue that drains during a pause."""
    take_up_share: float = 0.5
    """Share of the lead that may be spent on snapshots of layers that are taken up again."""

    def __post_init__(self) -> None:
        if not 0 < self.burst_s <= self.target_lead_s:
            raise InvalidError(
                f"burst_s {self.burst_s} is not in 0..target_lead_s {self.target_lead_s}"
            )
        for name in ("blind_lead_s", "start_s", "poll_s", "take_up_share"):
            if not getattr(self, name) > 0:
                raise InvalidError(f"{name} is {getattr(self, name)}; it must be positive")


class Media(Protocol):
    """The stream that a session plays; it may grow between two calls."""

    @property
    def fps(self) -> float: ...

    @property
    def swin_size(self) -> int: ...

    @property
    def segment_frames(self) -> int: ...

    @property
    def num_frames(self) -> int:
        """Frames that can be sent now."""
        ...

    @property
    def live(self) -> bool:
        """Whether num_frames may still grow."""
        ...

    @property
    def has_slots(self) -> bool:
        """Whether slots last: format version 2."""
        ...

    def slice_bytes(self, birth: int) -> tuple[float, ...]:
        """Bytes of a slice about `birth` with 1, 2, ... layers."""
        ...

    def snapshot_bytes(self, frame: int) -> tuple[float, ...]:
        """Bytes of the snapshots of 1, 2, ... layers at the first frame of the segment of `frame`.
        Asked for only where slots last."""
        ...


@dataclass(frozen=True, slots=True)
class SendSlice:
    """Send the slice born at `birth` with its layers 0..num_layers-1; tell `sending`."""

    birth: int
    num_layers: int


@dataclass(frozen=True, slots=True)
class SendSnapshots:
    """Send the snapshots of the layers first_layer..num_layers-1 at `frame`, the first of a
    segment, all together; tell `sending`."""

    frame: int
    first_layer: int
    num_layers: int


@dataclass(frozen=True, slots=True)
class WaitUntil:
    """Nothing to send before `time_s`."""

    time_s: float


@dataclass(frozen=True, slots=True)
class WaitForFrames:
    """All there is has been sent, but the stream is live: look for new frames."""


@dataclass(frozen=True, slots=True)
class Finished:
    """All that was asked for has been sent."""


Decision = SendSlice | SendSnapshots | WaitUntil | WaitForFrames | Finished


class PlaySession:
    """Sends the slices that show from `first_frame` on, up to but without `until_frame`."""

    def __init__(
        self,
        media: Media,
        policy: Policy,
        config: SessionConfig,
        now_s: float,
        first_frame: int = 0,
        until_frame: int | None = None,
        estimator: ThroughputEstimator | None = None,
    ) -> None:
        self._media = media
        self._policy = policy
        self._config = config
        self._estimator = estimator or ThroughputEstimator()
        self._first_frame = first_frame
        self._until_frame = until_frame
        self._started_s = now_s
        self.next_birth = first_frame - media.swin_size + 1
        """Birth of the slice that is sent next; before the first snapshots, their frame."""
        self._held: int | None = None
        """Layers of which the client holds every slot; None where slices are whole."""
        self._take_up: SendSnapshots | None = None
        if media.has_slots:
            self.next_birth = first_frame // media.segment_frames * media.segment_frames
            self._held = 0
        self._resting = False
        # When the client shows first_frame, shifted by every stall; None until the window has left.
        self._playing_since_s: float | None = None
        self._window_end_bytes: int | None = None
        self._window_sent_s = now_s
        self._sent_bytes = 0
        self._left_bytes = 0
        self._queued_bytes = 0
        self._observed_s = now_s
        self._moving = False

    @property
    def rate_bps(self) -> float | None:
        """The estimated throughput to this client."""
        return self._estimator.rate_bps

    def sending(self, num_bytes: int, now_s: float, queued_bytes: int) -> None:
        """A record of `num_bytes` is about to be handed to the connection."""
        self._observe(now_s, queued_bytes)
        self._sent_bytes += num_bytes
        self._queued_bytes += num_bytes
        window_whole = self.next_birth > self._first_frame
        if self._window_end_bytes is None and window_whole:
            self._window_end_bytes = self._sent_bytes
            self._window_sent_s = now_s

    def decide(self, now_s: float, queued_bytes: int) -> Decision:
        """What to do now, with `queued_bytes` of what was sent still waiting for the client."""
        self._observe(now_s, queued_bytes)
        media, config = self._media, self._config
        last = media.num_frames
        if self._until_frame is not None:
            last = min(last, self._until_frame)
        if self._take_up is not None:
            # It belongs between the slices of this frame and the next one.
            snapshots, self._take_up = self._take_up, None
            self._held = snapshots.num_layers
            return snapshots
        # The births before 0 come with the first segment, and so do snapshots.
        if not media.num_frames or self.next_birth >= last:
            done = self._until_frame is not None and self.next_birth >= self._until_frame
            return Finished() if done or not media.live else WaitForFrames()
        self._note_stall(now_s)
        missing = max(0, self._first_frame + 1 - self.next_birth)
        lead_s = self._lead_s(now_s)
        if not missing:
            resume_s = config.target_lead_s - config.burst_s
            self._resting = lead_s > (resume_s if self._resting else config.target_lead_s)
            if self._resting:
                pause_s = lead_s - resume_s
                if self._queued_bytes or self._playing_since_s is None:
                    pause_s = min(pause_s, config.poll_s)
                return WaitUntil(now_s + pause_s)
            if self._is_far_ahead_blind(now_s):
                return WaitUntil(now_s + config.poll_s)
        if self._held == 0:
            return self._join(self._situation(now_s, lead_s, last, missing))
        layers = self._held
        if not missing or layers is None:
            situation = self._situation(now_s, lead_s, last, missing)
            layers = self._policy.choose_layers(situation)
            if self._held is not None:
                layers = self._clip(layers, self._held, situation)
        decision = SendSlice(self.next_birth, layers)
        self.next_birth += 1
        return decision

    def _join(self, situation: Situation) -> SendSnapshots:
        """Begins with the snapshots of as many layers as fit, with the slices up to the first
        frame, the time that is left."""
        media, frame = self._media, self.next_birth
        num_slices = self._first_frame - frame
        sizes = zip(media.snapshot_bytes(frame), media.slice_bytes(frame), strict=True)
        window_bytes = tuple(snapshot + num_slices * slice for snapshot, slice in sizes)
        due = replace(situation, slice_bytes=window_bytes, missing_slices=1)
        self._held = self._policy.choose_layers(due)
        self.next_birth += 1
        return SendSnapshots(frame, 0, self._held)

    def _clip(self, wanted: int, held: int, situation: Situation) -> int:
        """How many of the `wanted` layers the next slice gets, of which `held` are of use. What
        lacks is taken up after it where that can be."""
        frame = self.next_birth
        self._held = min(wanted, held)
        if wanted > held and frame % self._media.segment_frames == 0:
            sizes, rate_bps = self._media.snapshot_bytes(frame), situation.rate_bps
            budget_s = self._config.take_up_share * situation.lead_s
            for layers in range(wanted, held, -1):
                cost_bits = 8 * (sizes[layers - 1] - sizes[held - 1])
                if rate_bps is None or cost_bits <= budget_s * rate_bps:
                    self._take_up = SendSnapshots(frame, held, layers)
                    break
        return self._held

    def _is_far_ahead_blind(self, now_s: float) -> bool:
        """Whether enough has been sent before anything is known of the link.

        The first picture is on its way, and all that is sent now would be of the base layer; but
        the client may have begun to play, so it must not run dry until the first news comes back.
        """
        if self.rate_bps is not None or not self._queued_bytes:
            return False
        ahead_s = (self.next_birth - self._first_frame) / self._media.fps
        return ahead_s - (now_s - self._window_sent_s) >= self._config.blind_lead_s

    def _situation(self, now_s: float, lead_s: float, last: int, missing: int) -> Situation:
        media, rate_bps = self._media, self.rate_bps
        goal_s = min(self._config.target_lead_s, lead_s + (last - self.next_birth) / media.fps)
        if missing:
            lead_s = self._started_s + self._config.start_s - now_s
        if rate_bps:
            lead_s -= 8 * self._queued_bytes / rate_bps
        return Situation(
            rate_bps=rate_bps,
            slice_bytes=media.slice_bytes(self.next_birth),
            frame_s=1 / media.fps,
            lead_s=max(0.0, lead_s),
            goal_lead_s=goal_s,
            missing_slices=missing,
        )

    def _lead_s(self, now_s: float) -> float:
        """Seconds until the next slice is due, if the client has all that was sent."""
        ahead_s = (self.next_birth - self._first_frame) / self._media.fps
        played_s = 0.0 if self._playing_since_s is None else now_s - self._playing_since_s
        return ahead_s - played_s

    def _note_stall(self, now_s: float) -> None:
        late_s = -self._lead_s(now_s)
        if self._playing_since_s is None or late_s <= 0:
            return
        # A client that ran dry at the live edge goes on once it holds a segment again: segments
        # come whole, so with less it would run dry at each one.
        hold_s = self._media.segment_frames / self._media.fps if self._media.live else 0.0
        self._playing_since_s += late_s + hold_s

    def _observe(self, now_s: float, queued_bytes: int) -> None:
        was_queued = self._queued_bytes > 0
        self._queued_bytes = queued_bytes
        left_bytes = max(self._left_bytes, self._sent_bytes - queued_bytes)
        gone_bytes, self._left_bytes = left_bytes - self._left_bytes, left_bytes
        elapsed_s, self._observed_s = now_s - self._observed_s, now_s
        # Time before the first byte of a busy spell has gone is latency, not throughput.
        if was_queued and (gone_bytes or self._moving):
            self._estimator.add(now_s, gone_bytes, elapsed_s, at_least=queued_bytes == 0)
        self._moving = queued_bytes > 0 and (self._moving or gone_bytes > 0)
        if (
            self._playing_since_s is None
            and self._window_end_bytes is not None
            and left_bytes >= self._window_end_bytes
        ):
            self._playing_since_s = now_s
