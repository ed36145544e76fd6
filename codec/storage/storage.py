"""The storage that a reader of a stream needs, that a server needs to find streams, and that one
writer needs to write one.

Rule: a path is relative, with '/' between its parts. Only regular files below the place are read,
and never more bytes than the caller has room for. Whatever a killed writer leaves, the log names
only files that are there, whole.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Protocol, runtime_checkable


@dataclass(frozen=True, slots=True)
class Stamp:
    """Metadata of a file, known without reading it; it changes with the content."""

    size_bytes: int
    identity: tuple[int | str, ...]
    """Whatever changes with the file."""


@runtime_checkable
class Storage(Protocol):
    """A place with the files of a stream."""

    @property
    def name(self) -> str:
        """Name of the place in messages."""

    @property
    def last_name(self) -> str:
        """The last part of its name, without what leads there; empty if there is none."""

    def place(self, path: str) -> str:
        """The whole name of the file at `path`, for errors."""

    def check(self) -> None:
        """Raises CorruptError if there is no such place, or if it cannot be read."""

    def read(
        self, path: str, limit_bytes: int, offset: int = 0, *, if_missing: str | None = None
    ) -> bytes:
        """The file at `path` from `offset` on. Raises CorruptError, as `codec.files.read_bounded`
        does."""

    def stamp(self, path: str) -> Stamp | None:
        """The stamp of the file at `path`, readable or not; None if there is nothing.

        Raises UnreadableError if the place does not tell.
        """

    def holds(self, path: str) -> bool:
        """Whether a regular file is at `path`. Raises UnreadableError."""

    def sizes(self, folder: str) -> Iterator[tuple[str, int]]:
        """The paths of the regular files two levels below the folder at `folder`, and their sizes
        in bytes. Raises UnreadableError."""


@runtime_checkable
class StorageRoot(Storage, Protocol):
    """A place that may have several streams below it, in folders or in a file each."""

    def below(self, folder: str) -> Storage:
        """The place of the folder at `folder`."""

    def folders(self, files: Sequence[str]) -> dict[str, tuple[Stamp | None, ...]]:
        """The folders one level below that hold the first of `files`, but hidden ones, and the
        stamps of all of `files` there. Raises UnreadableError if the place does not tell."""

    def files(self, suffix: str) -> dict[str, Stamp]:
        """The names of the files directly in the place that end with `suffix`, but hidden ones, and
        their stamps. Raises UnreadableError if the place does not tell."""

    def read_range(self, path: str, offset: int, size_bytes: int) -> bytes:
        """`size_bytes` bytes of the file at `path`, which has them. Raises CorruptError."""


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
