"""The frames of a play in groups that are decided on together."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

from codec.errors import InvalidError

from ..media import SegmentSizes, segment_start
from ..qoe import QoeConfig
from .feasible import Play

GROUP_S = 0.5
"""Seconds of a group where nothing else is asked for."""


@dataclass(frozen=True, slots=True)
class Group:
    """Frames of one segment and of one stretch of qoe.py."""

    first_frame: int
    end_frame: int
    stretch: int | None
    """None behind the last whole stretch."""
    sizes: SegmentSizes
    """Of the births first_frame..end_frame-1."""

    @property
    def num_frames(self) -> int:
        return self.end_frame - self.first_frame


@dataclass(frozen=True, slots=True)
class Grouping:
    """All groups of a play, in order."""

    groups: tuple[Group, ...]
    stretch_frames: int
    num_stretches: int


def group_frames(play: Play, config: QoeConfig, group_s: float = GROUP_S) -> Grouping:
    """Groups of `group_s` or less. Raises InvalidError."""
    if not group_s > 0:
        raise InvalidError(f"group_s is {group_s}; it must be positive")
    media, first, until = play.media, play.first_frame, play.until_frame
    stretch_frames = max(1, round(config.stretch_s * media.fps))
    num_stretches = max(1, play.num_frames // stretch_frames)
    starts = {
        *range(first, until, max(1, round(group_s * media.fps))),
        *range(first, until, stretch_frames),
        *range(segment_start(media, first), until, media.segment_frames),
    }
    bounds = [*sorted(start for start in starts if start >= first), until]
    groups = []
    for start, end in pairwise(bounds):
        stretch = (start - first) // stretch_frames
        place = stretch if stretch < num_stretches else None
        groups.append(Group(start, end, place, media.sizes(start)))
    return Grouping(tuple(groups), stretch_frames, num_stretches)
