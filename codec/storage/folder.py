"""Streams in a folder of this machine, read and written.

Rule: what is opened lies below the folder when all links are followed, and is a regular file. A
file is whole on disk (temporary name, fsync, rename) before the log names it (fsync).
"""

from __future__ import annotations

import errno
import os
import shutil
import stat
import sys
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

from codec.errors import CorruptError, InvalidError, MissingFolderError, UnreadableError
from codec.files import (
    append_durably,
    read_bounded,
    read_part,
    sync_folder,
    temporary_beside,
    write_atomic,
)
from codec.interrupts import postponed_interrupts

from .storage import Shape, Stamp

_MISSING = (FileNotFoundError, NotADirectoryError)

if sys.platform != "win32":
    _STEP = os.O_RDONLY | os.O_DIRECTORY | os.O_NOFOLLOW | os.O_CLOEXEC


class FolderStorage:
    """A folder, which need not be there yet, and whose name may come to stand for another one."""

    def __init__(self, folder: Path, root: Path | None = None) -> None:
        """root: the folder that links may not lead out of on the way to this one; by default it
        may be anywhere."""
        self._folder = folder
        self._root = folder if root is None else root

    @property
    def name(self) -> str:
        return str(self._folder)

    @property
    def last_name(self) -> str:
        return self._folder.resolve().name

    def place(self, path: str) -> str:
        return str(self._folder / path)

    def check(self) -> None:
        if not self._folder.is_dir():
            kind = CorruptError if self._folder.exists() else MissingFolderError
            raise kind(f"{self._folder} is not a folder; name the folder of a stream")

    def below(self, folder: str) -> FolderStorage:
        return FolderStorage(self._folder / folder, self._root)

    def read(
        self, path: str, limit_bytes: int, offset: int = 0, *, if_missing: str | None = None
    ) -> bytes:
        return read_bounded(
            self._folder / path, limit_bytes, offset, if_missing=if_missing, opener=self._open
        )

    def read_range(self, path: str, offset: int, size_bytes: int) -> bytes:
        return read_part(self._folder / path, offset, size_bytes, opener=self._open)

    def stamp(self, path: str) -> Stamp | None:
        try:
            found = os.stat(self._folder / path)
        except _MISSING:
            return None
        except OSError as error:  # something is there; reading it will say what is wrong
            return Stamp(0, (error.errno or 0,))
        return Stamp(
            found.st_size,
            (found.st_dev, found.st_ino, found.st_mode, found.st_mtime_ns, found.st_ctime_ns),
        )

    def holds(self, path: str) -> bool:
        try:
            return stat.S_ISREG(os.stat(self._resolved(self._folder / path)[1]).st_mode)
        except (OSError, CorruptError):
            return False

    def folders(self, files: Sequence[str]) -> dict[str, tuple[Stamp | None, ...]]:
        found = {}
        for name in self._names():
            first = self.stamp(f"{name}/{files[0]}")
            if first is not None:
                found[name] = (first, *(self.stamp(f"{name}/{file}") for file in files[1:]))
        return found

    def files(self, suffix: str) -> dict[str, Stamp]:
        names = (name for name in self._names() if name.endswith(suffix) and self.holds(name))
        stamps = {name: self.stamp(name) for name in names}
        return {name: stamp for name, stamp in stamps.items() if stamp is not None}

    def _names(self) -> list[str]:
        """Names of what is directly in the folder, but hidden ones."""
        try:
            return [name for name in os.listdir(self._folder) if not name.startswith(".")]
        except OSError as error:
            raise self._unlisted("", error) from error

    def sizes(self, folder: str) -> Iterator[tuple[str, int]]:
        for middle, _ in self._entries(folder):
            for path, size_bytes in self._entries(middle):
                if size_bytes is not None:
                    yield path, size_bytes

    def _entries(self, folder: str) -> list[tuple[str, int | None]]:
        """The paths of what is in the folder at `folder`, and the sizes of the regular files; none
        if it is not a folder that may be looked into."""
        found = []
        try:
            with os.scandir(self._resolved(self._folder / folder)[1]) as entries:
                for entry in entries:
                    path = f"{folder}/{entry.name}"
                    is_file = self.holds(path) if entry.is_symlink() else entry.is_file()
                    found.append((path, entry.stat().st_size if is_file else None))
        except (*_MISSING, CorruptError):
            return []
        except OSError as error:
            if error.errno == errno.ELOOP:
                return []
            raise self._unlisted(folder, error) from error
        return found

    def _unlisted(self, folder: str, error: OSError) -> UnreadableError:
        return UnreadableError(f"{self.place(folder)} cannot be listed: {error.strerror}")

    def _resolved(self, path: Path) -> tuple[str, str]:
        """The root, and `path`, with all links followed. Raises CorruptError for a path that leads
        out of the root, or of this folder."""
        root, folder, real = map(os.path.realpath, (self._root, self._folder, path))
        if not (_is_below(folder, root) and _is_below(real, folder)):
            raise CorruptError(f"{path} cannot be read: a link points outside its folder")
        return root, real

    def _open(self, path: str, flags: int) -> int:
        """An `Opener`. A link that comes after the look at the path is not followed, but on
        Windows, where folders cannot be opened."""
        root, real = self._resolved(Path(path))
        if sys.platform == "win32":
            return os.open(real, flags)
        *folders, name = os.path.relpath(real, root).split(os.sep)
        at = os.open(root, _STEP & ~os.O_NOFOLLOW)
        try:
            for folder in folders:
                below = os.open(folder, _STEP, dir_fd=at)
                os.close(at)
                at = below
            return os.open(name, flags | os.O_NONBLOCK | os.O_NOFOLLOW, dir_fd=at)
        finally:
            os.close(at)


def _is_below(path: str, folder: str) -> bool:
    return path == folder or path.startswith(folder.rstrip(os.sep) + os.sep)


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
