"""A place in a stream as a user writes it: a frame, `30`, or a time, `2.5s`."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass

from codec.console import option
from codec.errors import InvalidError
from codec.framerange import MAX_DIGITS

_TEXT = re.compile(rf"(\d{{1,{MAX_DIGITS}}})|(\d{{1,{MAX_DIGITS}}}(?:\.\d*)?|\.\d+)s", re.ASCII)


@dataclass(frozen=True, slots=True)
class Moment:
    """A frame, or the frame that shows at a time."""

    frame: int | None = None
    time_s: float | None = None
    """From the first frame on, at the stream's own rate. Counts where there is no `frame`."""

    def __str__(self) -> str:
        return f"{self.time_s:g}s" if self.frame is None else str(self.frame)

    @staticmethod
    def parse(text: str) -> Moment:
        """The moment in a text such as `30` or `2.5s`. Raises InvalidError."""
        match = _TEXT.fullmatch(text)
        if match is None:
            raise InvalidError(
                f"{text[:40]!r} is neither a frame, such as 30, nor a time, such as 2.5s"
            )
        if match[1] is not None:
            return Moment(frame=int(match[1]))
        return Moment(time_s=float(match[2]))

    def of(self, fps: float) -> int:
        """The number of the frame in a stream of that rate."""
        if self.frame is not None:
            return self.frame
        assert self.time_s is not None
        # A time that is written to the last digit belongs to the frame that begins then.
        return math.floor(self.time_s * fps + 1e-6)


MOMENT = option("FRAME|SECONDSs", Moment.parse)
"""For options that take a Moment: Annotated[Moment, MOMENT]."""
