"""Which frames of a stream are played."""

from __future__ import annotations

from dataclasses import dataclass

from .errors import InvalidError


@dataclass(frozen=True, slots=True)
class Frames:
    """The frames first..end-1."""

    first: int = 0
    end: int | None = None
    """None where the stream ends, which may not be known."""

    @property
    def count(self) -> int | None:
        return None if self.end is None else self.end - self.first

    @staticmethod
    def parse(text: str) -> Frames:
        """The frames in a text such as `30:60`, `30:` or `:60`. Raises InvalidError."""
        first, colon, end = text.partition(":")
        if not colon or not all(part == "" or part.isdecimal() for part in (first, end)):
            raise InvalidError(f"frames {text!r} are not FIRST:END, such as 30:60, 30: or :60")
        frames = Frames(int(first or 0), int(end) if end else None)
        if frames.end is not None and frames.end <= frames.first:
            raise InvalidError(f"frames {text!r} hold no frame; END must be above FIRST")
        return frames
