"""A stream that is written to an object store.

A store cannot append, so the log is replaced as a whole with each record, and each time only if it
is still what this writer left there (If-Match). A writer begins by putting a token after the last
whole record, where readers expect the torn record of a killed writer: from then on an earlier
writer finds another log than its own. The token goes with the next record, or at the end.
"""

from __future__ import annotations

import os
from collections.abc import Mapping

from codec.errors import ConflictError, InvalidError

from .objectstore import StorePrefix, Version, connect
from .storage import Shape

TOKEN_BYTES = 8
"""Shorter than any record."""


class GrowingStore(StorePrefix):
    """A prefix of an object store; holds the log."""

    def __init__(self, url: str, shape: Shape) -> None:
        super().__init__(url, *connect(url, patient=True))
        self._shape = shape
        self._log = b""  # whole records
        self._version: Version | None = None  # of the log in the store; None: there is none
        self._own: dict[str, Version] = {}
        """Versions of the files put for an entry that the log does not name yet, by path."""

    def check_unused(self) -> None:
        names = self.names()
        stamp = self.stamp(self._shape.log) if self._shape.log in names else None
        if stamp is not None and stamp.size_bytes <= TOKEN_BYTES:
            names.remove(self._shape.log)
        if names:
            raise InvalidError(f"{self.name} is not empty; delete it or name another place")

    def begin(self, head: bytes, others_began: bool = False) -> None:
        if not others_began:
            self.check_unused()
        found = self.read_version(self._shape.log, TOKEN_BYTES)
        self._version = None if found is None else found[1]
        self._swap(os.urandom(TOKEN_BYTES))
        try:
            # Last, because a place is a stream from the moment that it has its head.
            self.put(self._shape.head, head, None)
        except ConflictError as error:
            self._check_same(self._shape.head, head, error)

    def take_over(self, log_bytes: int, record_bytes: int, num_entries: int) -> None:
        stamp = self.stamp(self._shape.log)
        if stamp is None or not log_bytes <= stamp.size_bytes < log_bytes + record_bytes:
            raise self._not_alone()
        found = self.read_version(self._shape.log, log_bytes + record_bytes)
        if found is None or not log_bytes <= len(found[0]) < log_bytes + record_bytes:
            raise self._not_alone()
        self._log, self._version = found[0][:log_bytes], found[1]
        self._swap(self._log + os.urandom(TOKEN_BYTES))
        self.delete(f"{self._shape.folder}/{num_entries}")

    def add(self, entry: int, files: Mapping[str, bytes]) -> None:
        for name, data in files.items():
            path = f"{self._shape.folder}/{entry}/{name}"
            try:
                self._own[path] = self.put(path, data, self._own.get(path))
            except ConflictError:
                self._own[path] = self._replace(path, data)

    def append(self, log_bytes: int, records: bytes) -> None:
        log = self._log[:log_bytes] + records
        self._swap(log)
        self._log = log
        self._own.clear()

    def finish(self, head: bytes) -> None:
        self._swap(self._log)
        self.put(self._shape.head, head)

    def _swap(self, log: bytes) -> None:
        """Replaces the log, if no other writer has done so since this one did."""
        try:
            self._version = self.put(self._shape.log, log, self._version)
        except ConflictError as error:
            self._version = self._check_same(self._shape.log, log, error)

    def _replace(self, path: str, data: bytes) -> Version:
        """Overwrites what is at `path` already: put there by an earlier writer that does not know
        yet that it was replaced, or by this one, whose answer was lost."""
        self._swap(self._log + os.urandom(TOKEN_BYTES))  # raises if it is the other way round
        try:
            return self.put(path, data, self.version(path))
        except ConflictError as error:
            raise self._not_alone() from error

    def _check_same(self, path: str, data: bytes, error: ConflictError) -> Version:
        """Raises InvalidError unless `data` is what lies at `path`: then it was this writer who put
        it there, and only the answer was lost. Gives the version."""
        stamp = self.stamp(path)
        if stamp is not None and stamp.size_bytes == len(data):
            found = self.read_version(path, len(data))
            if found is not None and found[0] == data:
                return found[1]
        raise self._not_alone() from error

    def _not_alone(self) -> InvalidError:
        return InvalidError(
            f"{self.name}: another writer has written to this stream; run only one writer"
        )
