"""The storage that a reader of a stream needs, and what a server needs to find streams.

Rule: a path is relative, with '/' between its parts. Only regular files below the place are read,
and never more bytes than the caller has room for.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
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
