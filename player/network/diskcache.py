"""Objects on disk, for streams played again: named by their hash, so none is ever stale.

Several players may share a folder. It never fails a play: what cannot be kept is fetched again.
"""

from __future__ import annotations

import hashlib
import logging
import os
import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from codec.errors import InvalidError

log = logging.getLogger(__name__)

FILL_AFTER = 0.9
"""Share of the bound that is left when something had to go."""


@dataclass(slots=True)
class CacheCounts:
    """Counts of objects that were found, missing or damaged."""

    hits: int = 0
    misses: int = 0
    dropped: int = 0
    """Objects that had to make room."""
    damaged: int = 0
    """Files that did not hold what their name says."""
    failed: int = 0
    """Objects that could not be written."""


class DiskCache:
    """At most `max_bytes` of objects in `folder`; what was used longest ago goes first."""

    def __init__(self, folder: Path, max_bytes: int) -> None:
        """Makes `folder` if there is none. Files in it that are not the cache's are left alone."""
        if max_bytes < 1:
            raise InvalidError(
                f"a cache of {max_bytes} bytes is too small; give at least 1 byte, or no cache"
            )
        folder.mkdir(parents=True, exist_ok=True)
        self._folder, self._max_bytes = folder, max_bytes
        self._num_bytes = sum(size for _, size, _ in self._files())
        self.counts = CacheCounts()

    def has(self, sha256: bytes) -> bool:
        """Whether there seems to be the object of this hash; not counted."""
        return self._path(sha256).exists()

    def get(self, sha256: bytes) -> bytes | None:
        """The object of this hash, if it is there."""
        path = self._path(sha256)
        try:
            data = path.read_bytes()
            os.utime(path)
        except OSError:
            self.counts.misses += 1
            return None
        if hashlib.sha256(data).digest() != sha256:
            self.counts.damaged += 1
            self.counts.misses += 1
            self._remove(path, len(data))
            return None
        self.counts.hits += 1
        return data

    def put(self, sha256: bytes, data: bytes) -> None:
        """Keeps the object `data`, of this hash."""
        if len(data) > self._max_bytes * FILL_AFTER:
            return
        path = self._path(sha256)
        temporary = path.with_name(f"{path.name}.{os.getpid()}.tmp")
        try:
            path.parent.mkdir(exist_ok=True)
            try:
                temporary.write_bytes(data)
                # Not synced: after a power cut the hash shows what is damaged.
                os.replace(temporary, path)
            finally:
                temporary.unlink(missing_ok=True)
        except OSError as error:
            if not self.counts.failed:
                log.warning("%s: cannot store fetched objects: %s", self._folder, error)
            self.counts.failed += 1
            return
        self._num_bytes += len(data)
        if self._num_bytes > self._max_bytes:
            self._make_room()

    def _path(self, sha256: bytes) -> Path:
        name = sha256.hex()
        return self._folder / name[:2] / name

    def _files(self) -> Iterator[tuple[int, int, Path]]:
        """(When it was used, bytes, path) of everything that the cache has written."""
        for path in self._folder.glob("[0-9a-f][0-9a-f]/*"):
            if re.fullmatch(r"[0-9a-f]{64}(\.\d+\.tmp)?", path.name):
                try:
                    found = path.stat()
                except OSError:
                    continue  # another player has removed it
                yield found.st_mtime_ns, found.st_size, path

    def _make_room(self) -> None:
        # Others may have written here, or removed something.
        files = sorted(self._files())
        self._num_bytes = sum(size for _, size, _ in files)
        for _, size, path in files:
            if self._num_bytes <= self._max_bytes * FILL_AFTER:
                break
            self._remove(path, size)
            self.counts.dropped += 1

    def _remove(self, path: Path, size: int) -> None:
        try:
            path.unlink()
        except OSError:
            return
        self._num_bytes -= size
