"""From where the user wants files to a place that takes them whole, whoever writes them."""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import Protocol

from codec.files import read_bounded, write_atomic

from .objectstore import open_store
from .openstorage import Target, check_url, is_url


class Files(Protocol):
    """A place of files, each of which is there whole or not at all. Paths are relative, with '/'
    between their parts. Who writes a file again must write the same, or be alone."""

    @property
    def name(self) -> str:
        """What people call the place."""

    def holds(self, path: str) -> bool:
        """Whether there is such a file."""

    def read(self, path: str, limit_bytes: int) -> bytes:
        """The file at `path`. Raises CorruptError."""

    def put(self, path: str, data: bytes) -> object:
        """Puts or replaces the file at `path`. Raises OSError, UnwritableError."""

    def delete(self, path: str) -> None:
        """Deletes the file or the folder at `path`, if there is one."""


class FilesFolder:
    """A folder of this machine, or one that several machines share."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder

    @property
    def name(self) -> str:
        return str(self._folder)

    def holds(self, path: str) -> bool:
        return (self._folder / path).is_file()

    def read(self, path: str, limit_bytes: int) -> bytes:
        return read_bounded(self._folder / path, limit_bytes)

    def put(self, path: str, data: bytes) -> None:
        file = self._folder / path
        file.parent.mkdir(parents=True, exist_ok=True)
        write_atomic(file, data)

    def delete(self, path: str) -> None:
        found = self._folder / path
        if found.is_dir():
            shutil.rmtree(found)
        else:
            found.unlink(missing_ok=True)


def open_files(target: Target) -> Files:
    """The place at `target`; nothing is written yet. Raises InvalidError for a URL that cannot be
    one."""
    if not is_url(target):
        return FilesFolder(Path(target))
    check_url(str(target))
    return open_store(str(target), patient=True)
