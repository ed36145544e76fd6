"""The storage that one writer needs to write a stream.

Rule: whatever a killed writer leaves, the log names only files that are there, whole.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Protocol

from .storage import Storage


@dataclass(frozen=True, slots=True)
class Shape:
    """The names in a place that is filled entry by entry."""

    log: str
    """The file that grows by a record for each entry, after the entry's files are there."""
    head: str
    """The file without which the place is nothing: written when it begins and when it ends."""
    folder: str
    """Parent of the entries' folders: the files of entry n lie in its folder n."""


class GrowingPlace(Storage, Protocol):
    """A storage that one writer fills, entry by entry, with its log. Where it can tell, a second
    writer of the log gets an InvalidError. Each file is there whole or not at all."""

    def add(self, entry: int, files: Mapping[str, bytes]) -> None:
        """Puts the files of an entry, by their names in its folder."""

    def append(self, log_bytes: int, records: bytes) -> None:
        """Appends to the log, which has `log_bytes`: all of it, or it raises."""

    def finish(self, head: bytes) -> None:
        """Replaces the head; nothing is appended after it."""

    def names(self) -> set[str]:
        """Names of the files and folders directly in the place."""

    def put(self, path: str, data: bytes) -> object:
        """Puts or replaces the file at `path`. Several writers may do so at a time if they put the
        same. Raises OSError, UnwritableError."""

    def delete(self, path: str) -> None:
        """Deletes the file or the folder at `path`, if there is one."""

    def check_unused(self) -> None:
        """Raises InvalidError if there is more than what a writer may have left that was killed
        while it began."""

    def begin(self, head: bytes, others_began: bool = False) -> None:
        """Takes an unused place: the log is empty. others_began: pieces of it may be there (see
        `GrowingPiece`), so nothing is checked. Raises InvalidError."""

    def take_over(self, log_bytes: int, record_bytes: int, num_entries: int) -> None:
        """Goes on where another writer ended, after `num_entries` entries: the log keeps its first
        `log_bytes`, and what is not finished goes. Raises InvalidError if the log has a record
        more by now."""


class GrowingPiece:
    """Puts the files of some entries of a place; keeps their records for the writer of the log.

    Several pieces of one place may grow at a time. What a killed writer left is written again.
    """

    def __init__(self, storage: GrowingPlace, shape: Shape) -> None:
        self._storage = storage
        self._shape = shape
        self.name = storage.name
        self.records: list[bytes] = []
        """Records of the entries that are there, in order."""

    def add(self, entry: int, files: Mapping[str, bytes]) -> None:
        for name, data in files.items():
            self._storage.put(f"{self._shape.folder}/{entry}/{name}", data)

    def append(self, log_bytes: int, records: bytes) -> None:
        self.records.append(records)

    def finish(self, head: bytes) -> None:
        """The writer of the log replaces the head."""
