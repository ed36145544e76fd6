"""When frames show: the clock of a playback, in times and numbers of frames only.

Rule: whoever shows (the player), whoever guesses what is shown (the server) and whoever simulates
it run this very code. It reads no clock; events come with their time.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from codec.errors import InvalidError


@dataclass(frozen=True, slots=True)
class PlayoutConfig:
    """What a playback waits for."""

    start_lead_s: float = 0.1
    """Seconds of media, first frame included, that are there before the first frame shows: a link
    that just carries layer 0 delivers it unevenly."""
    resume_lead_s: float = 0.0
    """The same after a stall."""

    def __post_init__(self) -> None:
        for name in ("start_lead_s", "resume_lead_s"):
            if not 0 <= getattr(self, name) <= 60:
                raise InvalidError(f"{name} is {getattr(self, name)}; it must be in 0..60")


@dataclass(slots=True)
class Stall:
    """A frame that was not there when it was due."""

    frame: int
    due_s: float
    shown_s: float | None = None
    """None while it lasts."""


class PlayoutClock:
    """The time line of one playback from `first_frame` on.

    A frame can show when layer 0 of all that it needs has come. The first one shows when so much
    of the stream is there as the configuration asks for; every later one frame time after the one
    before. One that is not there by then stalls the picture, and what follows moves with it.
    """

    def __init__(
        self,
        first_frame: int,
        fps: float,
        config: PlayoutConfig | None = None,
        until_frame: int | None = None,
    ) -> None:
        """until_frame: the first frame that will not come; None while it is not known."""
        if first_frame < 0 or not fps > 0:
            raise InvalidError(f"playout: frame {first_frame}, {fps} fps")
        self._config = config or PlayoutConfig()
        self.first_frame = first_frame
        self.fps = fps
        self.until_frame = until_frame
        self.end_frame = first_frame
        """The first frame that cannot show yet."""
        self.started_s: float | None = None
        """When the first frame showed."""
        self.stall: Stall | None = None
        """The one that lasts."""
        self.stalls = 0
        self.stalled_s = 0.0
        # Due times are counted from the last start or stall, not summed up frame by frame.
        self._base_frame = first_frame
        self._base_s = 0.0

    def due_s(self, frame: int) -> float:
        """When `frame` shows if all comes in time; before the start, as if it were now 0."""
        return self._base_s + (frame - self._base_frame) / self.fps

    def next_frame(self, now_s: float) -> int:
        """The first frame that has not shown before `now_s`."""
        if self.started_s is None:
            return self.first_frame
        # A frame due at this very moment counts as next; rounding may not skip it.
        passed = math.ceil((now_s - self._base_s) * self.fps - 1e-6)
        return min(self.end_frame, self._base_frame + max(0, passed))

    def ready_until(self, end_frame: int, now_s: float) -> None:
        """At `now_s` all frames before `end_frame` can show."""
        self.tick(now_s)
        self.end_frame = max(self.end_frame, end_frame)
        self.tick(now_s)

    def tick(self, now_s: float) -> None:
        """Notes what has become of the next frame by `now_s`: starts, stalls, goes on."""
        if self.started_s is None:
            if self._has_lead(self.first_frame, self._config.start_lead_s):
                self.started_s = now_s
                self._base_frame, self._base_s = self.first_frame, now_s
            return
        if self.stall is None:
            ended = self.until_frame is not None and self.end_frame >= self.until_frame
            if not ended and now_s > self.due_s(self.end_frame) + 1e-9:
                self.stall = Stall(self.end_frame, self.due_s(self.end_frame))
        if self.stall is not None and self._has_lead(self.stall.frame, self._config.resume_lead_s):
            stall, self.stall = self.stall, None
            stall.shown_s = now_s
            self.stalls += 1
            self.stalled_s += now_s - stall.due_s
            self._base_frame, self._base_s = stall.frame, now_s

    def lead_s(self, now_s: float) -> float:
        """Seconds of media that are there beyond `now_s`."""
        if self.started_s is None or self.stall is not None:
            frame = self.first_frame if self.stall is None else self.stall.frame
            return (self.end_frame - frame) / self.fps
        return max(0.0, self.due_s(self.end_frame) - now_s)

    def _has_lead(self, frame: int, lead_s: float) -> bool:
        needed = frame + max(1, math.ceil(lead_s * self.fps - 1e-9))
        if self.until_frame is not None:
            needed = min(needed, max(self.until_frame, frame + 1))
        return self.end_frame >= needed
