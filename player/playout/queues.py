"""Bounded queues between the player's threads: the thread that fills one waits for room."""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Callable

from codec.errors import SwingsError
from player.network.fetch import StoppedError
from player.source.source import Packets
from server.abr.clientstatus import MAX_BUFFER_S, ClientStatus

from .clock import Clock, Smoothing
from .timeline import DueFrame, FrameRecord, Playout, PlayoutTotals

MAX_FRAMES_AHEAD = 2
"""Frames whose slices wait in the renderer to be drawn: one is packed while one is drawn."""


class EmptyStreamError(SwingsError):
    """The stream ended before its first frame was complete."""


class Events:
    """The queue between the stream and the playout: a Playout that threads can wait on."""

    def __init__(
        self,
        playout: Playout,
        clock: Clock,
        arrived: Callable[[Packets, float], None] | None = None,
        smoothing: Smoothing | None = None,
    ) -> None:
        """arrived: is called with all packets and when they came, before they wait for room.
        smoothing: None draws nothing between frames."""
        self._playout = playout
        self._clock = clock
        self._arrived = arrived
        self._smoothing = smoothing or Smoothing()
        self._changed = threading.Condition()
        self._finished = False
        self._stopped = False
        self._failure: BaseException | None = None
        self._full = False
        self._status_due = False  # whether the sender should get a status

    @property
    def totals(self) -> PlayoutTotals:
        return self._playout.totals

    @property
    def finished(self) -> bool:
        """Whether all of the stream has come."""
        return self._finished

    @property
    def end_frame(self) -> int:
        """The first frame that cannot show yet."""
        with self._changed:
            return self._playout.end_frame

    @property
    def end_s(self) -> float | None:
        """When the frame after the last one that has come would show; None before the first."""
        with self._changed:
            return self._playout.end_s

    def media_frame(self, now_s: float) -> float | None:
        """The frame whose time it is at `now_s` of the clock, see `PlayoutClock.media_frame`."""
        with self._changed:
            return self._playout.media_frame(now_s)

    def append(self, packets: Packets) -> None:
        """Adds packets that arrived now; waits for room first. Raises StoppedError."""
        if self._arrived is not None:
            self._arrived(packets, self._clock.now_s())
        with self._changed:
            # A capture draws at its own pace. While it holds the stream back no time passes, so
            # that a slow machine is not taken for a slow link.
            holds = not self._playout.has_room and not self._clock.real
            if holds:
                self._clock.stop()
            if not self._playout.has_room:
                self._note_full(True)
                self._changed.wait_for(lambda: self._playout.has_room or self._stopped)
                self._note_full(False)
            if holds:
                self._clock.start()
            if self._stopped:
                raise StoppedError("the player stopped")
            self._playout.push(packets, self._clock.now_s())
            self._changed.notify_all()

    def _note_full(self, full: bool) -> None:
        self._full = full
        self._status_due = True
        self._changed.notify_all()

    def reconnected(self) -> None:
        """A new connection follows, whose server does not know the state of the playback yet."""
        with self._changed:
            self._status_due = True
            self._changed.notify_all()

    def client_status(self, least_s: float, most_s: float) -> ClientStatus | None:
        """The state of the playback, `most_s` seconds from now, or sooner (`least_s` at least) when
        something has changed that the sender should know. None once nothing more will come."""
        with self._changed:

            def over() -> bool:
                return self._stopped or self._finished or self._failure is not None

            self._changed.wait_for(over, least_s)
            self._changed.wait_for(lambda: self._status_due or over(), most_s - least_s)
            if over():
                return None
            self._status_due = False
            frame, buffer_s = self._playout.place(self._clock.now_s())
            return ClientStatus(
                frame,
                min(buffer_s, MAX_BUFFER_S),
                # A clock that is not real stands while the queue is full: that is no pause.
                paused=self._clock.real and not self._clock.running,
                busy=self._full,
            )

    def finish(self) -> None:
        """No packets will follow."""
        with self._changed:
            self._playout.finish(self._clock.now_s())
            self._finished = True
            self._changed.notify_all()

    def fail(self, error: BaseException) -> None:
        """The stream broke: `wait_for_frame` raises `error`."""
        with self._changed:
            self._failure = error
            self._changed.notify_all()

    def stop(self) -> None:
        """Wakes all waiting threads."""
        with self._changed:
            self._stopped = True
            self._changed.notify_all()

    def time_changed(self) -> None:
        """Somebody has stopped or started the clock, or changed its rate."""
        with self._changed:
            self._status_due = True
            self._changed.notify_all()

    @property
    def shows_between(self) -> bool:
        """Whether pictures between frames are drawn at the current rate of the clock."""
        return self._smoothing.shows_between(self._clock.rate * self._playout.fps)

    def step(self) -> bool:
        """Moves the clock on to the next frame; gives whether that is there."""
        with self._changed:
            shown_s = self._playout.next_shown_s
            if shown_s is None:
                return False
            self._clock.skip_to(shown_s)
            self._changed.notify_all()
            return True

    def wait_for_frame(self) -> DueFrame | None:
        """The next frame, once it is due; None after the last one. Raises StoppedError."""
        with self._changed:
            while True:
                if self._stopped:
                    raise StoppedError("the player stopped")
                if self._failure is not None:
                    raise self._failure
                shown_s = self._playout.next_shown_s
                if shown_s is None and self._finished:
                    if not self.totals.frames:
                        raise EmptyStreamError("the stream ended before its first frame")
                    return None
                # None: until something changes, as where the clock stands.
                wait_s = None if shown_s is None else self._clock.until_s(shown_s)
                if shown_s is not None and wait_s == 0:
                    due = self._playout.pop_due()
                    assert due is not None
                    # Only here is it known when the picture began, or that it stood still.
                    self._status_due |= due.record.late or self.totals.frames == 1
                    self._changed.notify_all()
                    return due
                self._changed.wait(wait_s)


class Handoff:
    """Frames whose slices are in the renderer, on their way to be drawn."""

    def __init__(self, max_frames: int = MAX_FRAMES_AHEAD) -> None:
        self._max_frames = max_frames
        self._changed = threading.Condition()
        self._frames: deque[FrameRecord] = deque()
        self._finished = False
        self._stopped = False
        self._failure: BaseException | None = None

    def wait_for_room(self) -> None:
        """Returns when a frame may be added. Raises StoppedError."""
        with self._changed:
            self._changed.wait_for(lambda: len(self._frames) < self._max_frames or self._stopped)
            if self._stopped:
                raise StoppedError("the player stopped")

    def put(self, record: FrameRecord) -> None:
        with self._changed:
            self._frames.append(record)
            self._changed.notify_all()

    def finish(self, failure: BaseException | None = None) -> None:
        """Nothing will follow; asking for more raises `failure`."""
        with self._changed:
            self._finished = True
            self._failure = failure
            self._changed.notify_all()

    def stop(self) -> None:
        """Wakes all waiting threads."""
        with self._changed:
            self._stopped = True
            self._changed.notify_all()

    def get(self) -> FrameRecord | None:
        """The next frame; None after the last one."""
        with self._changed:
            self._changed.wait_for(lambda: bool(self._frames) or self._finished)
            return self._pop()

    @property
    def ended(self) -> bool:
        """Whether the last frame has been taken."""
        with self._changed:
            return self._finished and not self._frames

    def poll(self) -> list[FrameRecord]:
        """All frames that are there now, without waiting."""
        with self._changed:
            records = []
            while self._frames or self._failure is not None:
                record = self._pop()
                assert record is not None
                records.append(record)
            return records

    def _pop(self) -> FrameRecord | None:
        if self._failure is not None:
            raise self._failure
        if not self._frames:
            return None
        record = self._frames.popleft()
        self._changed.notify_all()
        return record
