"""What a place must be able to do so that one writer can make a stream in it.

Rule: whatever a killed writer leaves, the log names only files that are there, whole.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Protocol


@dataclass(frozen=True, slots=True)
class Shape:
    """The names in a place that is filled entry by entry."""

    log: str
    """The file that grows by a record for each entry, after the entry's files are there."""
    head: str
    """The file without which the place is nothing: written when it begins and when it ends."""
    folder: str
    """Of the entries: the files of entry n lie in its folder n."""


class GrowingPlace(Protocol):
    """A place that one writer fills. Where it can tell, a second writer gets an InvalidError."""

    @property
    def name(self) -> str:
        """What people call the place."""

    def check_unused(self) -> None:
        """Raises InvalidError if there is more than what a writer may have left that was killed
        while it began."""

    def names(self) -> set[str]:
        """Of the files and folders directly in the place."""

    def remove(self, name: str) -> None:
        """Removes the file called `name` beside the log."""

    def begin(self, head: bytes, others_began: bool = False) -> None:
        """Takes an unused place: the log is empty. others_began: pieces of it may be there (see
        `GrowingPiece`), so nothing is checked. Raises InvalidError."""

    def take_over(self, log_bytes: int, record_bytes: int, num_entries: int) -> None:
        """Goes on where another writer ended, after `num_entries` entries: the log keeps its first
        `log_bytes`, and what is not finished goes. Raises InvalidError if the log has a record
        more by now."""

    def add(self, entry: int, files: Mapping[str, bytes]) -> None:
        """Puts the files of an entry, by their names in its folder."""

    def append(self, log_bytes: int, records: bytes) -> None:
        """Appends to the log, which has `log_bytes`: all of it, or it raises."""

    def put(self, path: str, data: bytes) -> None:
        """Puts or replaces a file beside the log, whole."""

    def finish(self, head: bytes) -> None:
        """Replaces the head; nothing is appended after it."""
