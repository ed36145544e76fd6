"""A range of frames as a user writes it: `30:60`, `30:` or `:60`."""

from __future__ import annotations

import logging
from dataclasses import dataclass

from .console import option
from .errors import InvalidError

_log = logging.getLogger(__name__)

MAX_DIGITS = 18
"""Digits read of a frame number: a number of thousands of them is not even converted."""


@dataclass(frozen=True, slots=True)
class FrameRange:
    """The frames first..end-1."""

    first: int = 0
    end: int | None = None
    """None where the stream or capture ends, which may not be known."""

    def __str__(self) -> str:
        return f"{self.first}:{'' if self.end is None else self.end}"

    @property
    def count(self) -> int | None:
        return None if self.end is None else self.end - self.first

    @staticmethod
    def parse(text: str) -> FrameRange:
        """The frames in a text such as `30:60`, `30:` or `:60`. Raises InvalidError."""
        first, colon, end = text.partition(":")
        if not colon or not all(p == "" or (p.isascii() and p.isdigit()) for p in (first, end)):
            raise InvalidError(f"frames {text[:40]!r} are not FIRST:END, such as 30:60, 30: or :60")
        if max(len(first), len(end)) > MAX_DIGITS:
            raise InvalidError(
                f"frames {text[:40]!r}...: a number of more than {MAX_DIGITS} digits"
            )
        frames = FrameRange(int(first or 0), int(end) if end else None)
        if frames.end is not None and frames.end <= frames.first:
            raise InvalidError(f"frames {text!r} hold no frame; END must be above FIRST")
        return frames

    def of(self, num_frames: int, name: object) -> range:
        """The frames as a range of the `num_frames` that `name` has; a warning says if these end
        before. Raises InvalidError if none is left."""
        end = num_frames if self.end is None else min(self.end, num_frames)
        if not 0 <= self.first < end:
            raise InvalidError(f"frames {self}: {name} has frames 0:{num_frames}")
        if self.end is not None and end < self.end:
            _log.warning(
                f"frames {self}: {name} has frames 0:{num_frames}; {self.first}:{end} are taken"
            )
        return range(self.first, end)


FRAMES = option("A:B", FrameRange.parse)
"""For options that take a FrameRange: Annotated[FrameRange, FRAMES]."""
