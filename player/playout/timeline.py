"""When each frame is shown, and with which packets of a bounded queue; and where a playback goes on
after seeking, stepping, looping and the end.

Rule: pure. Packets and their arrival times come in, frames and the times at which they show come
out; nothing here reads a clock, waits, decodes or draws. `Transport` knows frames, not times: pause
and rate belong to the clock.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass

from codec.errors import InvalidError
from codec.stream.manifest import Manifest
from player.source.source import Packets
from server.abr.holding import Holding
from server.abr.media import SegmentSizes
from server.abr.playout import PlayoutClock, PlayoutConfig


@dataclass(frozen=True, slots=True)
class QueueConfig:
    """Bounds of the queue. When it is full the stream waits: nothing is ever dropped."""

    max_frames: int = 600
    """Frames that may wait in the queue."""
    max_bytes: int = 128 << 20
    """Bytes of packets that may wait in the queue. What the next frame needs always fits."""


@dataclass(frozen=True, slots=True)
class FrameRecord:
    """How one frame was shown; times are seconds since the player started."""

    frame: int
    layers: int
    """Layers that show in it: those of which nothing is missing."""
    wire_bytes: int
    """Bytes of the packets that came into use with this frame."""
    due_s: float
    """When it should have shown: a frame time after the one before; the first, when it did."""
    shown_s: float
    """When it showed."""
    concealed: bool = False
    """Whether it came only after it was due, and put nothing off: the frame before stood for it."""
    play: int = 0
    """Which play it is of: each seek and each loop begins one."""
    decode_s: float = 0.0
    """Time it took to decode and to pack what came into use with it, seconds."""

    @property
    def late(self) -> bool:
        """Whether the picture stood still because a slice was not there when due."""
        return self.shown_s > self.due_s


@dataclass(frozen=True, slots=True)
class DueFrame:
    """A frame to show now, and the packets that came into use with it."""

    record: FrameRecord
    packets: tuple[Packets, ...]


@dataclass(slots=True)
class PlayoutTotals:
    """Running sums over the frames shown so far: constant size however long the stream."""

    frames: int = 0
    startup_s: float = 0.0
    """From the start of the clock to the first picture."""
    stalls: int = 0
    stalled_s: float = 0.0
    concealed: int = 0
    """Frames that came after they were due, and put nothing off."""
    layers: int = 0
    """Sum over the frames of the layers that show."""
    fewest_layers: int | None = None
    """The fewest layers that showed in any frame; None before the first frame."""
    wire_bytes: int = 0
    late_packets: int = 0
    """Packets that came after the first frame that they could show in."""
    most_frames_waiting: int = 0
    most_bytes_waiting: int = 0

    @property
    def mean_layers(self) -> float:
        return self.layers / self.frames if self.frames else 0.0

    def note_fewest(self, layers: int) -> None:
        """A frame shows `layers`."""
        known = self.fewest_layers
        self.fewest_layers = layers if known is None else min(known, layers)

    def add(self, other: PlayoutTotals, startup_s: float) -> None:
        """Adds what another play came to, which began to show `startup_s` after it was asked
        for."""
        self.frames += other.frames
        self.startup_s += startup_s
        self.stalls += other.stalls
        self.stalled_s += other.stalled_s
        self.concealed += other.concealed
        self.layers += other.layers
        if other.fewest_layers is not None:
            self.note_fewest(other.fewest_layers)
        self.wire_bytes += other.wire_bytes
        self.late_packets += other.late_packets
        self.most_frames_waiting = max(self.most_frames_waiting, other.most_frames_waiting)
        self.most_bytes_waiting = max(self.most_bytes_waiting, other.most_bytes_waiting)


class PlayedMedia:
    """A stream as a client knows it that has its manifest and no more."""

    def __init__(self, manifest: Manifest) -> None:
        self.fps = manifest.fps
        self.segment_frames = manifest.segment_frames
        self.num_layers = manifest.num_layers
        self.num_frames = 0
        self.live = manifest.live
        nothing = (0.0,) * self.num_layers
        # A layer that lacks a change does not count as shown.
        self._sizes = SegmentSizes(nothing, nothing, nothing, (1.0,) * self.num_layers)

    def sizes(self, birth: int) -> SegmentSizes:
        return self._sizes


@dataclass(slots=True)
class _Waiting:
    """Packets that no frame has used yet."""

    packets: Packets
    came_s: float


class Playout:
    """The time line of one playback; `PlayoutClock` says when a frame shows.

    A frame shows with all that has come by then, of its own slice and of those before it. What
    comes later shows from the next frame on.
    """

    def __init__(
        self,
        manifest: Manifest,
        first_frame: int,
        until_frame: int | None = None,
        queue: QueueConfig | None = None,
        config: PlayoutConfig | None = None,
        needed: int = 1,
        *,
        not_before_s: float = 0.0,
        play: int = 0,
    ) -> None:
        """until_frame: the first that will not come, if that is known. needed: layers without
        which a frame does not show. not_before_s: the first frame does not show earlier. play: the
        number that its frames carry."""
        media = PlayedMedia(manifest)
        self._queue = queue or QueueConfig()
        self._play = play
        self._clock = PlayoutClock(first_frame, media.fps, config, until_frame, not_before_s)
        self._here = Holding(media, first_frame, needed)
        self._shown = Holding(media, first_frame)
        self._waiting: dict[int, deque[_Waiting]] = {}
        self._queue_bytes = 0
        self._next_frame = first_frame
        self._last_came_s = 0.0
        self.totals = PlayoutTotals()

    @property
    def frames_waiting(self) -> int:
        """Frames that can show and have not."""
        return self._clock.end_frame - self._next_frame if self._ready else 0

    def place(self, now_s: float) -> tuple[int, float]:
        """The next frame to show, and the seconds of media that can show from it on: by the time
        line, however far behind it the drawing is."""
        clock = self._clock
        frame = clock.next_frame(now_s)
        return frame, (clock.end_frame - frame) / clock.fps

    @property
    def fps(self) -> float:
        """Frames a second of media."""
        return self._clock.fps

    @property
    def end_frame(self) -> int:
        """The first frame that cannot show yet."""
        return self._clock.end_frame

    @property
    def end_s(self) -> float | None:
        """When the frame after the last one would show; None before the first one shows."""
        clock = self._clock
        return None if clock.started_s is None else clock.due_s(clock.end_frame)

    def media_frame(self, now_s: float) -> float | None:
        """See `PlayoutClock.media_frame`."""
        return self._clock.media_frame(now_s)

    @property
    def _ready(self) -> bool:
        return self._clock.started_s is not None and self._next_frame < self._clock.end_frame

    @property
    def has_room(self) -> bool:
        """Whether `push` takes packets now; always while the next frame is not complete."""
        return not self._ready or (
            self.frames_waiting < self._queue.max_frames
            and self._queue_bytes < self._queue.max_bytes
        )

    def push(self, packets: Packets, now_s: float) -> None:
        """Takes packets that came at `now_s`. Raises InvalidError when the queue is full."""
        if not self.has_room:
            raise InvalidError("playout: the queue is full; wait for room")
        self._last_came_s = now_s = max(now_s, self._last_came_s)
        packets.add_to(self._here)
        frame = packets.first_frame
        self._waiting.setdefault(frame, deque()).append(_Waiting(packets, now_s))
        self._queue_bytes += packets.wire_bytes
        self._clock.ready_until(self._here.end_frame, now_s)
        totals = self.totals
        totals.most_frames_waiting = max(totals.most_frames_waiting, self.frames_waiting)
        totals.most_bytes_waiting = max(totals.most_bytes_waiting, self._queue_bytes)

    def finish(self, now_s: float) -> None:
        """No packets will come: what is there shows, however little it is."""
        self._clock.until_frame = self._here.end_frame
        self._clock.ready_until(self._here.end_frame, max(now_s, self._last_came_s))

    @property
    def next_shown_s(self) -> float | None:
        """When the next frame shows; None while a slice of it has not arrived."""
        return self._clock.times_s(self._next_frame)[1] if self._ready else None

    def pop_due(self, now_s: float = float("inf")) -> DueFrame | None:
        """The next frame if it shows at or before `now_s`, else None."""
        if not self._ready:
            return None
        frame = self._next_frame
        due_s, shown_s = self._clock.times_s(frame)
        if shown_s > now_s:
            return None
        concealed = frame < self._clock.concealed_until
        taken = self._used(frame, float("inf") if concealed else shown_s)
        for packets in taken:
            packets.add_to(self._shown)
        wire_bytes = sum(packets.wire_bytes for packets in taken)
        self._queue_bytes -= wire_bytes
        record = FrameRecord(
            frame,
            self._shown.whole_layers(frame),
            wire_bytes,
            due_s,
            shown_s,
            concealed=concealed,
            play=self._play,
        )
        totals = self.totals
        totals.concealed = self._clock.concealed_frames
        if not totals.frames:
            totals.startup_s = shown_s
        if record.late:
            totals.stalls += 1
            totals.stalled_s += shown_s - due_s
        totals.frames += 1
        totals.layers += record.layers
        totals.note_fewest(record.layers)
        totals.wire_bytes += wire_bytes
        self._next_frame += 1
        self._clock.forget(self._next_frame)
        self._here.forget(self._next_frame)
        self._shown.forget(frame)
        return DueFrame(record, tuple(taken))

    def _used(self, frame: int, until_s: float) -> list[Packets]:
        """Takes the packets out of the queue that came by `until_s` and that `frame` is the first
        to show, in order of birth, a keyframe behind the slice of its frame."""
        used: list[Packets] = []
        for birth in sorted(birth for birth in self._waiting if birth <= frame):
            waiting = self._waiting[birth]
            come = [one.packets for one in waiting if one.came_s <= until_s]
            if len(come) == len(waiting):
                del self._waiting[birth]
            else:
                self._waiting[birth] = deque(one for one in waiting if one.came_s > until_s)
            if birth < frame and self.totals.frames:
                self.totals.late_packets += len(come)
            used += come
        return used


RATES = (0.1, 0.25, 0.5, 1.0, 1.5, 2.0, 4.0)
"""Rates that the keys step through, seconds of media per second."""


LIVE_LEAD_S = 1.0
"""How far from the edge of a live stream one begins, at most: nearer, the picture would stand still
until the next segment."""

LIVE_MARGIN_S = 0.1
"""What a segment that was just written may be late by, beyond its length."""


def live_lead_s(segment_s: float) -> float:
    """How far from the edge of a live stream with segments of `segment_s` one begins, seconds."""
    return min(LIVE_LEAD_S, segment_s + LIVE_MARGIN_S)


@dataclass(slots=True)
class Transport:
    """The frames that may be played, and which of them shows."""

    first_frame: int
    end_frame: int | None
    """The first frame that will not come; None while it is not known."""
    fps: float
    plays_left: float = 1
    """How often it is played yet, this time included; math.inf for without end."""
    shown: int | None = None
    """The last frame that showed; None before the first one."""
    lead_s: float = LIVE_LEAD_S
    """How far from the edge of a live stream `newest` is."""
    known_end: int = 0
    """Frames before this one are there, of a stream whose end is not known."""

    def __post_init__(self) -> None:
        if self.end_frame is not None and self.end_frame <= self.first_frame:
            raise InvalidError(f"there is no frame to play in {self.first_frame}:{self.end_frame}")

    @property
    def last_frame(self) -> int:
        """The last frame that one can go to."""
        end = self.known_end if self.end_frame is None else self.end_frame
        return max(self.first_frame, end - 1)

    @property
    def newest(self) -> int:
        """The frame to seek to for the newest pictures."""
        if self.end_frame is not None:
            return self.last_frame
        return self.seek(self.last_frame - round(self.lead_s * self.fps))

    @property
    def at_end(self) -> bool:
        """Whether the last frame shows."""
        return (
            self.shown is not None and self.end_frame is not None and self.shown >= self.last_frame
        )

    @property
    def loops(self) -> bool:
        """Whether it begins anew at the end."""
        return self.plays_left > 1

    def toggle_loop(self) -> bool:
        """Plays without end, or only to the end of this time; gives whether it is without end."""
        self.plays_left = 1 if self.loops else math.inf
        return self.loops

    def seek(self, frame: int) -> int:
        """The frame to play from where `frame` is wanted."""
        return min(max(frame, self.first_frame), self.last_frame)

    def skip(self, seconds: float, from_frame: int | None = None) -> int:
        """The frame to play from where `seconds` of media, of either sign, are to be skipped.
        from_frame: where a seek that has not come to its end leads; None for what shows."""
        at = self.shown if from_frame is None else from_frame
        at = self.first_frame if at is None else at
        return self.seek(at + round(seconds * self.fps))


def next_rate(rate: float, steps: int) -> float:
    """The rate `steps` places on in RATES, of either sign."""
    nearest = min(range(len(RATES)), key=lambda n: abs(RATES[n] - rate))
    return RATES[min(max(nearest + steps, 0), len(RATES) - 1)]
