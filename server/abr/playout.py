"""When frames show: the clock of a playback, in times and numbers of frames only.

Rule: the player, the server's model of a player, and the simulator run this same code. It reads no
clock; events come with their time.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from codec.errors import InvalidError

LONGER_LEAD_S = 1.0
CALM_S = 20.0
"""For `PlayoutConfig.longest_lead_s`."""


@dataclass(frozen=True, slots=True)
class PlayoutConfig:
    """Buffering before frames show."""

    start_lead_s: float = 0.1
    """Seconds of media, first frame included, that must arrive before the first frame shows: a link
    that just carries layer 0 delivers it unevenly."""
    resume_lead_s: float = 0.1
    """The same after a stall: otherwise a link too slow for layer 0 would show each frame as it
    arrives."""
    longest_lead_s: float = 0.0
    """The most that is waited for after stalls that follow each other within CALM_S of playback,
    LONGER_LEAD_S first and then twice as much each time. 0 waits for resume_lead_s always, and so
    does a live stream, whose next frames may not exist yet."""
    conceal_s: float = 0.0
    """Seconds that the picture may freeze while the media time runs on. If the late frame arrives
    in that time, playback skips to the current frame without delay. If not, playback stalls."""

    def __post_init__(self) -> None:
        for name in ("start_lead_s", "resume_lead_s", "longest_lead_s", "conceal_s"):
            if not 0 <= getattr(self, name) <= 60:
                raise InvalidError(f"{name} is {getattr(self, name)}; it must be in 0..60")

    def start_frames(self, fps: float) -> int:
        """How many frames the first one waits for, itself included."""
        return _frames(self.start_lead_s, fps)

    def least_frames(self, fps: float) -> int:
        """How many frames a playback may wait for."""
        return max(self.start_frames(fps), _frames(self.resume_lead_s, fps))


def _frames(lead_s: float, fps: float) -> int:
    return max(1, math.ceil(lead_s * fps - 1e-9))


class PlayoutClock:
    """The time line of one playback from `first_frame` on.

    A frame can show when layer 0 of all that it needs has come. The first one shows when so much
    of the stream is there as the configuration asks for; every later one frame time after the one
    before. One that is not there by then holds the picture. If it comes soon, the frames in
    between are left out (they are concealed); else it stalls the picture until there is some lead
    again, and what follows moves with it.
    """

    def __init__(
        self,
        first_frame: int,
        fps: float,
        config: PlayoutConfig | None = None,
        until_frame: int | None = None,
        not_before_s: float = 0.0,
    ) -> None:
        """until_frame: the first frame that will not come; None while it is not known.
        not_before_s: the first frame does not show earlier."""
        if first_frame < 0 or not fps > 0:
            raise InvalidError(f"playout: frame {first_frame}, {fps} fps")
        self._config = config or PlayoutConfig()
        self.first_frame = first_frame
        self.fps = fps
        self.until_frame = until_frame
        self._not_before_s = not_before_s
        self.end_frame = first_frame
        """The first frame that cannot show yet."""
        self._here_frame = first_frame
        """The first frame that is not there; those before it may still wait for a lead."""
        self._lead_s = 0.0  # that the last stall waited for
        self._resumed_s = -math.inf  # when it ended
        self.stalls = 0
        self.stalled_s = 0.0
        """Seconds of the stalls that are over."""
        self.concealed_until = first_frame
        """The frame after the last one that came too late to show, and put nothing off."""
        self.concealed_frames = 0
        """How many of them there were."""
        # (frame, time shown) of the start, of each stall and of each report: due times are
        # counted from the last one, not summed up frame by frame.
        self._bases: list[tuple[int, float]] = []
        self._started_s = 0.0

    @property
    def started_s(self) -> float | None:
        """When the first frame showed; None before."""
        return self._started_s if self._bases else None

    def times_s(self, frame: int) -> tuple[float, float]:
        """(due, shown) of a frame that can show, once playing has begun."""
        n = len(self._bases) - 1
        while n > 0 and self._bases[n][0] > frame:
            n -= 1
        base_frame, base_s = self._bases[n]
        shown_s = base_s + (frame - base_frame) / self.fps
        if frame > base_frame or n == 0:
            return shown_s, shown_s
        before_frame, before_s = self._bases[n - 1]
        return before_s + (frame - before_frame) / self.fps, shown_s

    def due_s(self, frame: int) -> float:
        """When `frame` shows if nothing stalls any more, once playing has begun."""
        base_frame, base_s = self._bases[-1]
        return base_s + (frame - base_frame) / self.fps

    def next_frame(self, now_s: float) -> int:
        """The first frame that has not shown before `now_s`."""
        if not self._bases:
            return self.first_frame
        # A frame due at this very moment counts as next; rounding may not skip it.
        base_frame, base_s = self._bases[-1]
        passed = math.ceil((now_s - base_s) * self.fps - 1e-6)
        return min(self.end_frame, base_frame + max(0, passed))

    def media_frame(self, now_s: float) -> float | None:
        """The frame whose time it is at `now_s`, with the part of it that is over; None before the
        first one, after the last one, and while the picture stands still for longer than that is
        concealed."""
        n = len(self._bases) - 1
        while n >= 0 and self._bases[n][1] > now_s:
            n -= 1
        if n < 0:
            return None
        base_frame, base_s = self._bases[n]
        frame = base_frame + (now_s - base_s) * self.fps
        is_last = n == len(self._bases) - 1
        end_frame = self.end_frame if is_last else self._bases[n + 1][0]
        conceals = not (is_last and self._ended)
        held_frames = self._config.conceal_s * self.fps if conceals else 0.0
        return frame if frame < end_frame + held_frames else None

    def early_frames(self, now_s: float) -> int:
        """Number of frames before the first received one that are still to be shown: a returning
        client shows its buffered frames first."""
        if not self._bases:
            return 0
        return max(0, math.floor((self._bases[-1][1] - now_s) * self.fps + 1e-6))

    def stalled(self, now_s: float) -> bool:
        """Whether the picture stands still at `now_s` because the next frame is not there."""
        if not self._bases or self._ended:
            return False
        return now_s > self.due_s(self.end_frame) + 1e-9

    def ready_until(self, end_frame: int, now_s: float) -> None:
        """At `now_s` all that the frames before `end_frame` need is there."""
        self._here_frame = max(self._here_frame, end_frame)
        if not self._bases:
            if self._has_lead(self.first_frame, self._config.start_lead_s):
                self._started_s = max(now_s, self._not_before_s)
                self._bases.append((self.first_frame, self._started_s))
        elif self.stalled(now_s):
            if self._conceals(now_s):
                return
            lead_s = self._resume_lead_s
            if not self._has_lead(self.end_frame, lead_s):
                return
            self._lead_s, self._resumed_s = lead_s, now_s
            self.stalls += 1
            self.stalled_s += now_s - self.due_s(self.end_frame)
            self._bases.append((self.end_frame, now_s))
        self.end_frame = self._here_frame

    @property
    def _resume_lead_s(self) -> float:
        """The lead that the stall waits for that is under way."""
        config = self._config
        is_calm = self.due_s(self.end_frame) - self._resumed_s > CALM_S
        if is_calm or self.until_frame is None:
            return config.resume_lead_s
        longer_s = min(config.longest_lead_s, max(LONGER_LEAD_S, 2 * self._lead_s))
        return max(config.resume_lead_s, longer_s)

    def _conceals(self, now_s: float) -> bool:
        """Goes on as if nothing had been missing, where that lasted no longer than it may."""
        held_s = now_s - self.due_s(self.end_frame)
        if held_s > self._config.conceal_s + 1e-9 or self._here_frame == self.end_frame:
            return False
        missed = min(self._here_frame, self.end_frame + math.ceil(held_s * self.fps - 1e-6))
        self.concealed_frames += missed - self.end_frame
        self.concealed_until, self.end_frame = missed, self._here_frame
        return True

    def set_next_frame(self, frame: int, now_s: float) -> None:
        """The player reports that it shows `frame` next, at `now_s`; from then on its time line
        holds. It cannot have shown frames that have not arrived. A frame before the first received
        one delays the first one.
        """
        frame = min(frame, self._here_frame)
        if frame > self.end_frame:
            self.end_frame = self._here_frame
        if not self._bases:
            if frame == self.first_frame:
                return
            self._started_s = now_s
        base_frame = max(frame, self.first_frame)
        while self._bases and self._bases[-1][0] >= base_frame:
            self._bases.pop()
        self._bases.append((base_frame, now_s + (base_frame - frame) / self.fps))

    def forget(self, frame: int) -> None:
        """Times before those of `frame` are not asked for any more."""
        while len(self._bases) > 2 and self._bases[2][0] <= frame:
            del self._bases[0]

    @property
    def _ended(self) -> bool:
        return self.until_frame is not None and self.end_frame >= self.until_frame

    def _has_lead(self, frame: int, lead_s: float) -> bool:
        needed = frame + _frames(lead_s, self.fps)
        if self.until_frame is not None:
            needed = min(needed, max(self.until_frame, frame + 1))
        return self._here_frame >= needed
