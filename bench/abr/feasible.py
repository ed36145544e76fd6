"""When frames can show at the earliest, and when they must at the latest.

Rule: only layer 0 and the rules of a play count here: the lead that it may have and what the first
frame waits for. Nothing else can make a frame come earlier, and to wait on purpose is allowed.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from bench.abr.passage import Passage
from codec.errors import InvalidError
from server.abr.link import Link
from server.abr.media import Media
from server.abr.session import SessionConfig

SLACK_S = 1e-6
"""Tolerance of times, for the rounding of clocks; too small to affect a bound."""
SLACK_BYTES = 1.0
"""The same for bytes: what just passes before an outage must not wait until it is over."""


@dataclass(frozen=True, slots=True)
class Play:
    """The given facts of every play of these frames over this link."""

    media: Media
    passage: Passage
    first_frame: int
    until_frame: int
    lead_frames: int
    """A frame's packets are sent once the one so many before it shows."""
    start_frames: int
    """Frames that are there before the first one shows."""
    base_bytes: tuple[float, ...]
    """For each frame, the least bytes of layer 0 beyond those that the frames before it need."""

    @property
    def num_frames(self) -> int:
        return self.until_frame - self.first_frame

    @property
    def frame_s(self) -> float:
        return 1 / self.media.fps


def open_play(
    media: Media, link: Link, config: SessionConfig, first_frame: int, until_frame: int
) -> Play:
    """Raises InvalidError for frames that are not there, or a play that never begins."""
    if not 0 <= first_frame < until_frame <= media.num_frames:
        frames = f"{first_frame}..{until_frame - 1} of {media.num_frames}"
        raise InvalidError(f"frames {frames}: give at least one frame, all of the stream")
    num_frames = until_frame - first_frame
    lead_frames = max(1, round(config.max_lead_s * media.fps))
    start_frames = min(num_frames, config.playout.start_frames(media.fps))
    if start_frames > lead_frames:
        raise InvalidError(
            f"the play cannot start: the first frame waits for {start_frames} frames, "
            f"but only {lead_frames} are sent ahead"
        )
    base_bytes = (
        _first_bytes(media, first_frame),
        *(_base_bytes(media, frame) for frame in range(first_frame + 1, until_frame)),
    )
    return Play(
        media,
        Passage(link),
        first_frame,
        until_frame,
        config.lead_frames(media.fps),
        start_frames,
        base_bytes,
    )


def _base_bytes(media: Media, birth: int) -> float:
    """The least that layer 0 takes from one frame to the next."""
    sizes = media.sizes(birth)
    if birth % media.segment_frames == 0:
        return min(sizes.layer_bytes[0], sizes.keyframe_bytes[0])
    return sizes.layer_bytes[0]


def _first_bytes(media: Media, frame: int) -> float:
    """The least that layer 0 takes for `frame` to show when nothing is there."""
    # Any keyframe before will do, with all changes since.
    least, since = math.inf, 0.0
    for birth in range(frame, -1, -1):
        sizes = media.sizes(birth)
        if birth % media.segment_frames == 0:
            least = min(least, since + sizes.keyframe_bytes[0])
        since += sizes.layer_bytes[0]
        if since >= least:
            break
    return least


def earliest_s(play: Play) -> list[float]:
    """When each frame shows at the earliest, in any play."""
    comes_s: list[float] = []
    shown_s: list[float] = []
    num_bytes = 0.0
    for n, more_bytes in enumerate(play.base_bytes):
        if n >= play.lead_frames:
            # Of the frames before the first one that waits for this one none has shown yet.
            num_bytes = max(num_bytes, play.passage.bytes_by(shown_s[n - play.lead_frames]))
        num_bytes += more_bytes
        passed_s = play.passage.earliest_s(num_bytes - SLACK_BYTES)
        comes_s.append(play.passage.comes_s(passed_s - SLACK_S))
        if n + 1 == play.start_frames:
            shown_s = [comes_s[-1] + k * play.frame_s for k in range(n + 1)]
        elif n >= play.start_frames:
            shown_s.append(max(shown_s[-1] + play.frame_s, comes_s[-1]))
    return shown_s


def waiting_s(play: Play, last_shown_s: float) -> float:
    """Total waiting of a play that shows its last frame at `last_shown_s`."""
    return last_shown_s - (play.num_frames - 1) * play.frame_s


def latest_s(play: Play, most_waiting_s: float) -> list[float]:
    """When each frame shows at the latest, in any play that waits `most_waiting_s` in all.

    A frame that shows late holds up what is sent a lead after it, so waiting early does not always
    save from waiting later.
    """
    count = play.num_frames
    shown_s = [0.0] * count
    begins = [0.0] * count  # bytes that have passed when layer 0 of the frame begins to, at most
    due_s = most_waiting_s + count * play.frame_s
    after = math.inf
    for n in range(count - 1, -1, -1):
        due_s -= play.frame_s
        if n + play.lead_frames < count:
            begin = begins[n + play.lead_frames] + SLACK_BYTES
            due_s = min(due_s, play.passage.latest_s(begin))
        shown_s[n] = due_s
        after = begins[n] = min(due_bytes(play, due_s), after) - play.base_bytes[n]
    return shown_s


def due_bytes(play: Play, time_s: float) -> float:
    """Bytes that have passed, at most, of what has come by `time_s`."""
    passed_s = play.passage.passed_s(time_s + SLACK_S)
    return play.passage.bytes_by(passed_s) + SLACK_BYTES
