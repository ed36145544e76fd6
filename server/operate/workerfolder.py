"""The folder of one server's workers: their sockets, and the files of their metrics.

Rule: it is held by a lock that ends with its processes, so that what killed servers left is known,
and it lies in memory where there is such a place: a disk may be full, or cleared by age, and a page
of a mapped file that cannot be stored ends its process.
"""

from __future__ import annotations

import fcntl
import os
import shutil
import tempfile
from contextlib import suppress
from pathlib import Path
from typing import Final

SHARED_MEMORY: Final = "/dev/shm" if os.access("/dev/shm", os.W_OK) else None
"""Where files are memory; None where there is no such folder."""

PREFIX: Final = "swings-serve-"

LOCK: Final = ".lock"


class WorkerFolder:
    """Belongs to the process that makes it and to those that it forks."""

    def __init__(self, place: str | None = SHARED_MEMORY) -> None:
        """place: the folder for it; None for that of temporary files."""
        root = Path(place or tempfile.gettempdir())
        for other in root.glob(f"{PREFIX}*"):
            _remove_dead(other)
        self.path = Path(tempfile.mkdtemp(prefix=PREFIX, dir=root))
        self._lock = os.open(self.path / LOCK, os.O_RDWR | os.O_CREAT, 0o600)
        fcntl.flock(self._lock, fcntl.LOCK_EX)

    def make(self) -> None:
        """Makes the folder again if it is gone."""
        self.path.mkdir(mode=0o700, exist_ok=True)

    def is_first(self, what: str) -> bool:
        """Whether no process of the server has asked so before."""
        try:
            os.close(os.open(self.path / what, os.O_CREAT | os.O_EXCL))
        except FileExistsError:
            return False
        return True

    def remove(self) -> None:
        shutil.rmtree(self.path, ignore_errors=True)


def _remove_dead(folder: Path) -> None:
    """Removes the folder of a server that has died; of one that lives, or of others, nothing."""
    with suppress(OSError), open(folder / LOCK, "rb") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        shutil.rmtree(folder)
