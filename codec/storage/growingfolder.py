"""A stream that is written to a folder of this machine.

Rule: a file is whole on disk (temporary name, fsync, rename) before the log names it (fsync).
"""

from __future__ import annotations

import os
import shutil
from collections.abc import Mapping
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

from codec.errors import InvalidError
from codec.files import append_durably, sync_folder, temporary_beside, write_atomic
from codec.interrupts import postponed_interrupts

from .folder import FolderStorage
from .growingplace import Shape


class GrowingFolder(FolderStorage):
    """A folder of this machine, or one that several machines share, which need not be there yet.
    The user sees to it that there is one writer, by codec/outputlock."""

    def __init__(self, folder: Path, shape: Shape) -> None:
        super().__init__(folder)
        self._shape = shape

    def check_unused(self) -> None:
        path = self._folder
        if path.exists() and not (path.is_dir() and self._is_unused()):
            raise InvalidError(f"{path} is not empty; remove it or name another folder")

    def _is_unused(self) -> bool:
        path, shape = self._folder, self._shape
        leftovers = [temporary_beside(path / name) for name in (shape.log, shape.head)]
        return all(
            (entry.name == shape.log and not entry.stat().st_size)
            or (entry.name == shape.folder and entry.is_dir() and not any(entry.iterdir()))
            or entry in leftovers
            for entry in path.iterdir()
        )

    def names(self) -> set[str]:
        return {entry.name for entry in self._folder.iterdir()} if self._folder.is_dir() else set()

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

    def begin(self, head: bytes, others_began: bool = False) -> None:
        if not others_began:
            self.check_unused()
        self._folder.mkdir(parents=True, exist_ok=True)
        (self._folder / self._shape.folder).mkdir(exist_ok=True)
        write_atomic(self._folder / self._shape.log, b"")
        # Last, because a folder is a stream from the moment that it has its head.
        write_atomic(self._folder / self._shape.head, head)

    def take_over(self, log_bytes: int, record_bytes: int, num_entries: int) -> None:
        path = self._folder
        # Takes off what a killed writer left after the last whole record.
        os.truncate(path / self._shape.log, log_bytes)
        for leftover in (*path.glob(".*.tmp"), *(path / self._shape.folder).glob("*/.*.tmp")):
            leftover.unlink()

    def add(self, entry: int, files: Mapping[str, bytes]) -> None:
        folder = self._folder / self._shape.folder
        parent = folder / str(entry)
        parent.mkdir(exist_ok=True)
        # The disk makes several files last in about the time of one.
        with (
            postponed_interrupts(),
            ThreadPoolExecutor(max_workers=max(1, len(files))) as threads,
        ):
            paths = [parent / name for name in files]
            list(threads.map(write_atomic, paths, files.values()))
        sync_folder(folder)

    def append(self, log_bytes: int, records: bytes) -> None:
        # A reader may have seen the records already: no signal takes them back.
        with postponed_interrupts():
            append_durably(self._folder / self._shape.log, log_bytes, records)

    def finish(self, head: bytes) -> None:
        write_atomic(self._folder / self._shape.head, head)
