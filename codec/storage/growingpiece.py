"""A piece of a stream that somebody else puts together: its segments, and what the index will say
of them."""

from __future__ import annotations

from collections.abc import Mapping

from .growingplace import Shape
from .openfiles import Files


class GrowingPiece:
    """Puts the files of some entries of a place; keeps their records for whoever has the log.

    Several pieces of one place may grow at a time. What a killed writer left is written again.
    """

    def __init__(self, files: Files, shape: Shape) -> None:
        self._files = files
        self._shape = shape
        self.records: list[bytes] = []
        """Of the entries that are there, in order."""

    @property
    def name(self) -> str:
        return self._files.name

    def check_unused(self) -> None:
        """Others write here, too."""

    def names(self) -> set[str]:
        return set()

    def remove(self, name: str) -> None:
        self._files.delete(name)

    def begin(self, head: bytes, others_began: bool = False) -> None:
        """Whoever has the log has begun."""

    def take_over(self, log_bytes: int, record_bytes: int, num_entries: int) -> None:
        """There is nothing to tidy up: what is not whole has never been put."""

    def add(self, entry: int, files: Mapping[str, bytes]) -> None:
        for name, data in files.items():
            self._files.put(f"{self._shape.folder}/{entry}/{name}", data)

    def append(self, log_bytes: int, records: bytes) -> None:
        self.records.append(records)

    def put(self, path: str, data: bytes) -> None:
        self._files.put(path, data)

    def finish(self, head: bytes) -> None:
        """Whoever has the log will."""
