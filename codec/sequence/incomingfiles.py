"""A numbered sequence that somebody is still writing: which frame comes next, and when it is whole.

Rule: a file counts once it can be read in full and has stood still for a moment. A frame is given
up only when a later file has been there for some time, so that a slow writer loses nothing.
"""

from __future__ import annotations

import logging
import os
import time
from collections import Counter, deque
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from codec.errors import InvalidError, SwingsError, UnreadableError
from codec.interop.formats import has_known_suffix
from codec.splats import Splats

from .survey import number_of, read_frame

_log = logging.getLogger(__name__)

POLL_S = 0.02
"""Seconds between two looks at the folder."""

SETTLE_S = 0.02
"""For so long a file stands still before it is read: a writer that is at work writes more often."""

SETTLE_UNSIZED_S = 0.5
"""The same for .splat, which does not say how long it is, if no later file is there."""

MAX_TAKEN = 64
"""Files that are looked at again after they were taken, one at each look."""

MAX_LOGGED = 5
"""Lines about each kind of trouble; further ones are counted only."""

Seen = tuple[int, int]
"""Size in bytes and time of the last change in nanoseconds, of a file."""


@dataclass(frozen=True, slots=True)
class Arrival:
    """The next frame of a sequence."""

    number: int
    """In the name of its file."""
    splats: Splats | None
    """None if its file is missing, or cannot be read."""
    written_s: float
    """When the file was last written, in seconds since the epoch."""


class Troubles:
    """Logs what is wrong with a sequence, and counts it by its kind."""

    def __init__(self) -> None:
        self.counts: Counter[str] = Counter()

    def note(self, kind: str, text: str) -> None:
        """Logs `text`; `kind`, a noun in the plural, is what is counted."""
        self.counts[kind] += 1
        if self.counts[kind] <= MAX_LOGGED:
            last = self.counts[kind] == MAX_LOGGED
            _log.warning("%s%s", text, f" (further {kind} are only counted)" if last else "")

    def __str__(self) -> str:
        return ", ".join(f"{count} {kind}" for kind, count in self.counts.items())


class Arrivals:
    """The frames of a folder in order of number, as they come."""

    def __init__(
        self,
        folder: Path,
        next_number: int | None,
        step: int,
        patience_s: float,
        troubles: Troubles,
        now_s: Callable[[], float] = time.monotonic,
    ) -> None:
        """next_number: the one to begin with; None for the lowest that there is. step: from one
        frame to the next. patience_s: see `FollowOptions`. Raises InvalidError if there is no
        folder."""
        if not folder.is_dir():
            raise InvalidError(f"{folder} is not a folder; --follow needs one, which may be empty")
        self._folder, self._step, self._patience_s = folder, step, patience_s
        self._troubles, self._now_s = troubles, now_s
        self.next_number = next_number
        self._listed_ns = -1
        self._files: dict[int, Path] = {}  # of numbers that have not come yet
        self._came_s: dict[int, float] = {}  # when each of them was first seen
        self._known: set[str] = set()
        self._has_listed = self._is_away = False
        self._taken: deque[tuple[Path, Seen]] = deque(maxlen=MAX_TAKEN)  # those that came last
        self._seen: tuple[Seen, float] | None = None  # of the next file, and since when
        self._refused: tuple[Seen, SwingsError] | None = None

    @property
    def next_name(self) -> str:
        """The file that is awaited, for messages."""
        if self.next_number is None:
            return f"the first file in {self._folder}"
        path = self._files.get(self.next_number)
        return f"frame {self.next_number}" if path is None else path.name

    @property
    def first_number(self) -> int | None:
        """The lowest number that is there and has not come; None if there is none."""
        return min(self._files, default=None)

    def poll(self) -> Arrival | None:
        """The next frame, if it is whole by now, or given up; call it every POLL_S. None while the
        folder is away, as a share of a network may be."""
        try:
            self._list()
        except OSError as error:
            if not self._is_away:
                text = f"{self._folder} is away: {error.strerror}; waiting for it"
                self._troubles.note("absences of the folder", text)
            self._is_away, self._listed_ns = True, -1
            return None
        self._is_away = False
        self._look_back()
        if self.next_number is None:
            if not self._files:
                return None
            self.next_number = min(self._files)
        number, now_s = self.next_number, self._now_s()
        later = [other for other in self._files if other > number]
        path = self._files.get(number)
        if path is not None:
            found = self._read(path, bool(later), now_s)
            if found is not None:
                return self._gone_on(found)
        if not later:
            return None
        waits_since_s = min(self._came_s[other] for other in later)
        if path is not None and self._seen is not None:
            waits_since_s = max(waits_since_s, self._seen[1])  # somebody writes it yet
        if now_s < waits_since_s + self._patience_s:
            return None
        name = self._files[min(later)].name
        if path is None:
            text = f"{self._folder}: frame {number} is missing, but {name} has come"
            self._troubles.note("missing files", f"{text}; the frame before stands for it")
        else:
            reason = self._refused[1] if self._refused else f"{path} changes all the time"
            self._troubles.note("odd files", f"{reason}; the frame before stands for it")
        return self._gone_on(Arrival(number, None, time.time()))

    def _look_back(self) -> None:
        """Looks at one of the files that came last: a writer that rested may have gone on."""
        if not self._taken:
            return
        path, seen = self._taken.popleft()
        try:
            status = path.stat()
        except OSError:  # many delete what has been taken
            return
        if (status.st_size, status.st_mtime_ns) == seen:
            self._taken.append((path, seen))
            return
        text = f"{path} changed after it was taken; the stream keeps what it held then"
        self._troubles.note("changed files", text)

    def _gone_on(self, arrival: Arrival) -> Arrival:
        if arrival.number in self._files:
            if arrival.splats is not None and self._seen is not None:
                self._taken.append((self._files[arrival.number], self._seen[0]))
            self._forget(arrival.number)
        self.next_number = arrival.number + self._step
        self._seen = self._refused = None
        return arrival

    def _forget(self, number: int) -> None:
        del self._files[number], self._came_s[number]

    def _list(self) -> None:
        """Takes in new names. A folder that did not change is not read again."""
        changed_ns = os.stat(self._folder).st_mtime_ns
        # Names that come within the clock's tick of the last look may not change the time.
        if changed_ns == self._listed_ns and time.time_ns() - changed_ns > 1_000_000_000:
            return
        self._listed_ns = changed_ns
        with os.scandir(self._folder) as entries:
            names = {entry.name for entry in entries}
        for name in sorted(names - self._known):
            path = self._folder / name
            if not name.startswith(".") and has_known_suffix(path):
                self._add(path)
        self._known, self._has_listed = names, True
        gone = [number for number, path in self._files.items() if path.name not in names]
        for number in gone:
            self._forget(number)

    def _add(self, path: Path) -> None:
        note = self._troubles.note
        number = number_of(path)
        if number is None:
            note("odd names", f"{path}: its name has no number to sort a sequence by; left out")
        elif not path.is_file():
            note("odd names", f"{path} is not a regular file; left out")
        elif self.next_number is not None and number < self.next_number:
            if not self._has_listed:  # a resumed stream has it already
                return
            note("late files", f"{path} comes too late, its frame has passed; left out")
        elif self.next_number is not None and (number - self.next_number) % self._step:
            note("odd names", f"{path} is not one of every {self._step}; left out")
        elif number in self._files:
            other = self._files[number].name
            note("odd names", f"{path} has the same number as {other}; left out")
        else:
            self._files[number] = path
            self._came_s[number] = self._now_s()

    def _read(self, path: Path, is_overtaken: bool, now_s: float) -> Arrival | None:
        """The frame in `path`; None while that is not whole."""
        assert self.next_number is not None
        try:
            status = path.stat()
        except OSError:  # gone again
            self._seen = None
            return None
        seen = status.st_size, status.st_mtime_ns
        if self._seen is None or self._seen[0] != seen:
            self._seen = seen, now_s
        unsized = path.suffix.lower() == ".splat" and not is_overtaken
        still_s = now_s - self._seen[1]
        # What has been written long ago needs no watching.
        still_s = max(still_s, min(time.time() - status.st_mtime, 2 * SETTLE_UNSIZED_S))
        if still_s < (SETTLE_UNSIZED_S if unsized else SETTLE_S):
            return None
        if self._refused is not None and self._refused[0] == seen:
            return None
        try:
            splats = read_frame(path)
            changed = path.stat()
        except (UnreadableError, OSError):  # the same may be well at the next look
            return None
        except SwingsError as error:
            self._refused = seen, error
            return None
        if (changed.st_size, changed.st_mtime_ns) != seen:
            return None
        return Arrival(self.next_number, splats, status.st_mtime)
