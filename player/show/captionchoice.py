"""The captions of a stream in a window: which language shows, and its text at a time."""

from __future__ import annotations

import logging
from collections.abc import Callable, Sequence
from itertools import islice

from codec.errors import InvalidError, SwingsError
from codec.stream.captions import Captions, Cue, parse_webvtt

from .backgroundtask import BackgroundTask

log = logging.getLogger(__name__)

MAX_LINES, MAX_LINE_CHARS = 12, 200
"""The lines that show at once, and the letters of each: a stranger's file may have a million."""


class CaptionChoice:
    """Files are read when they are first chosen, on a thread: the window does not wait for them.
    One that cannot be read is logged, and shows nothing."""

    def __init__(
        self,
        captions: Sequence[Captions],
        read: Callable[[str], bytes],
        language: str | None = None,
    ) -> None:
        """read: gives a file of the stream by its name; raises a SwingsError. language: shows from
        the start. Raises InvalidError where there are no captions in it."""
        self._captions, self._read = captions, read
        self._cues: dict[str, tuple[Cue, ...]] = {}
        self.chosen: Captions | None = None
        """What shows; None for nothing."""
        if language is not None:
            found = [each for each in captions if each.is_in(language)]
            if not found:
                names = ", ".join(each.language for each in captions) or "none at all"
                raise InvalidError(f"captions {language}: this stream has {names}")
            self._choose(found[0])

    def next(self) -> None:
        """Chooses the next language; none after the last."""
        order = [*self._captions, None]
        at = order.index(self.chosen) + 1
        self._choose(order[at % len(order)])

    def _choose(self, captions: Captions | None) -> None:
        self.chosen = captions
        if captions is not None and captions.language not in self._cues:
            self._cues[captions.language] = ()
            BackgroundTask(lambda: self._load(captions))

    def _load(self, captions: Captions) -> None:
        try:
            self._cues[captions.language] = parse_webvtt(self._read(captions.file_name))
        except SwingsError as error:
            log.warning("no captions in %s: %s", captions.language, error)

    def lines(self, time_s: float) -> tuple[str, ...]:
        """The lines that show at `time_s` of the stream, top to bottom; MAX_LINES of MAX_LINE_CHARS
        at most."""
        if self.chosen is None:
            return ()
        cues = self._cues[self.chosen.language]
        due = (cue for cue in cues if cue.start_s <= time_s < cue.end_s)
        lines = (line for cue in due for line in cue.text.split("\n", MAX_LINES)[:MAX_LINES])
        return tuple(line[:MAX_LINE_CHARS] for line in islice(lines, MAX_LINES))
