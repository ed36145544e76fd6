"""When each frame is shown: the time line and its bounded queue of slices.

Rule: pure. Slices and their arrival times come in, frames and the times at which they show come
out; nothing here reads a clock, waits or draws.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass

from codec.errors import CorruptError, InvalidError
from codec.slice import Slice, window_births
from player.source.source import ReceivedSlice


@dataclass(frozen=True, slots=True)
class PlayoutConfig:
    """Bounds of the queue. When it is full the stream waits: nothing is ever dropped."""

    max_frames: int = 240
    """Frames that may wait in the queue."""
    max_bytes: int = 512 << 20
    """Decoded bytes that may wait in the queue. A window always fits, however large it is."""


@dataclass(frozen=True, slots=True)
class FrameRecord:
    """What became of one frame, in seconds since the player started."""

    frame: int
    layers: int
    """Layers of the slice that was born in this frame."""
    wire_bytes: int
    """Bytes of the slices that came with this frame: the whole window at the first one."""
    due_s: float
    """When it should have shown: a frame time after the one before; the first, when it did."""
    shown_s: float
    """When it showed."""

    @property
    def late(self) -> bool:
        """Whether the picture stood still because a slice was not there when due."""
        return self.shown_s > self.due_s


@dataclass(frozen=True, slots=True)
class DueFrame:
    """A frame to show now, and the slices that it needs beyond those shown before."""

    record: FrameRecord
    slices: tuple[Slice, ...]


@dataclass(slots=True)
class PlayoutTotals:
    """Running sums over the frames shown so far: constant size however long the stream."""

    frames: int = 0
    startup_s: float = 0.0
    """From the start of the player to its first picture."""
    stalls: int = 0
    stalled_s: float = 0.0
    layers: int = 0
    """Sum over the frames of the layers of the slice born in each."""
    wire_bytes: int = 0
    most_frames_waiting: int = 0
    most_bytes_waiting: int = 0

    @property
    def mean_layers(self) -> float:
        return self.layers / self.frames if self.frames else 0.0


class Playout:
    """The time line of one playback from `first_frame` on.

    The first frame shows when its whole window has arrived. Every later one is due one frame time
    after the one before was shown; a slice that is not there by then stalls the picture, and what
    follows moves with it.
    """

    def __init__(
        self, first_frame: int, swin_size: int, fps: float, config: PlayoutConfig | None = None
    ) -> None:
        if first_frame < 0 or swin_size < 1 or not fps > 0:
            raise InvalidError(f"playout: frame {first_frame}, window {swin_size}, {fps} fps")
        self._config = config or PlayoutConfig()
        self._first_frame = first_frame
        self._frame_s = 1.0 / fps
        self._queue: deque[tuple[ReceivedSlice, float]] = deque()
        self._queue_bytes = 0
        self._next_frame = first_frame
        self._swin_size = swin_size
        self.next_birth = window_births(first_frame, swin_size).start
        """Birth of the slice that `push` wants next."""
        self._last_arrival_s = -math.inf
        # Due times are counted from the last start or stall, not summed up frame by frame.
        self._base_frame = first_frame
        self._base_s = 0.0
        self.totals = PlayoutTotals()

    @property
    def frames_waiting(self) -> int:
        """Frames that are complete in the queue."""
        return self.next_birth - self._next_frame if self._ready else 0

    @property
    def _needed(self) -> int:
        """Slices that the next frame takes out of the queue."""
        return self._swin_size if self._next_frame == self._first_frame else 1

    @property
    def _ready(self) -> bool:
        return len(self._queue) >= self._needed

    @property
    def has_room(self) -> bool:
        """Whether `push` takes a slice now; always while the next frame is not complete."""
        return not self._ready or (
            self.frames_waiting < self._config.max_frames
            and self._queue_bytes < self._config.max_bytes
        )

    def push(self, received: ReceivedSlice, now_s: float) -> None:
        """Takes the slice born at `next_birth`, which arrived at `now_s`.

        Raises CorruptError when it is another one, and InvalidError when the queue is full.
        """
        if received.slice.birth != self.next_birth:
            raise CorruptError(
                f"the stream brought the slice born at {received.slice.birth} where "
                f"{self.next_birth} belongs"
            )
        if not self.has_room:
            raise InvalidError("playout: the queue is full; wait for room")
        self._last_arrival_s = max(now_s, self._last_arrival_s)
        self._queue.append((received, self._last_arrival_s))
        self._queue_bytes += received.memory_bytes
        self.next_birth += 1
        totals = self.totals
        totals.most_frames_waiting = max(totals.most_frames_waiting, self.frames_waiting)
        totals.most_bytes_waiting = max(totals.most_bytes_waiting, self._queue_bytes)

    def _times_s(self) -> tuple[float, float]:
        """(due, shown) of the next frame, which is complete."""
        complete_s = self._queue[self._needed - 1][1]
        if self._next_frame == self._first_frame:
            return complete_s, complete_s
        due_s = self._base_s + (self._next_frame - self._base_frame) * self._frame_s
        return due_s, max(due_s, complete_s)

    @property
    def next_shown_s(self) -> float | None:
        """When the next frame shows; None while a slice of it has not arrived."""
        return self._times_s()[1] if self._ready else None

    def take(self, now_s: float = math.inf) -> DueFrame | None:
        """The next frame if it shows at or before `now_s`, else None."""
        if not self._ready:
            return None
        due_s, shown_s = self._times_s()
        if shown_s > now_s:
            return None
        taken = [self._queue.popleft()[0] for _ in range(self._needed)]
        self._queue_bytes -= sum(received.memory_bytes for received in taken)
        record = FrameRecord(
            self._next_frame,
            taken[-1].layers,
            sum(received.wire_bytes for received in taken),
            due_s,
            shown_s,
        )
        totals = self.totals
        if self._next_frame == self._first_frame:
            totals.startup_s = shown_s
        if self._next_frame == self._first_frame or record.late:
            self._base_frame, self._base_s = self._next_frame, shown_s
        if record.late:
            totals.stalls += 1
            totals.stalled_s += shown_s - due_s
        totals.frames += 1
        totals.layers += record.layers
        totals.wire_bytes += record.wire_bytes
        self._next_frame += 1
        return DueFrame(record, tuple(received.slice for received in taken))
