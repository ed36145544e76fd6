"""Captures in an object store, as folders of this machine that are empty but for small files.

What a layout reads as it opens (tables, poses, points) is copied. Pictures and videos, which are
most of a capture, stand there as empty files, so that all that lists a folder works as ever; their
bytes are read from the store each time they are asked for: a picture whole, a video in blocks. So
memory and disk stay the same however long a capture is.

State: the captures that this process has opened, by their folders; these go when it ends.
"""

from __future__ import annotations

import atexit
import io
import shutil
import tempfile
from collections.abc import Collection, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import Any, BinaryIO

from codec.errors import CodecError
from codec.files import opened_regular
from codec.storage.objectstore import REQUESTS, StorePrefix, open_store
from codec.storage.openstorage import Target, is_url

from .errors import CaptureError

MAX_COPIED_BYTES = 1 << 30
"""Largest size of all files that are copied."""

MAX_FILES = 1 << 22
"""Most files of a capture: more than ten hours of 30 cameras."""

MAX_PICTURE_BYTES = 1 << 28
"""Largest size of one picture's file."""

BLOCK_BYTES = 1 << 20
"""Size of the blocks in which a video is read, one of which is held."""


@dataclass(frozen=True, slots=True)
class StoredFiles:
    """A capture of a store, and the folder that stands for it."""

    store: StorePrefix
    folder: Path
    sizes: dict[str, int]
    """Sizes of the files that are empty in the folder, in bytes, by their paths."""

    def renamed(self, error: CaptureError) -> CaptureError:
        """The error with the URL in place of the folder."""
        return CaptureError(str(error).replace(str(self.folder), self.store.name))


_OPENED: dict[Path, StoredFiles] = {}


def forget_stored() -> None:
    """Removes the folders; nothing of them can be read any more."""
    while _OPENED:
        folder, _ = _OPENED.popitem()
        shutil.rmtree(folder.parent, ignore_errors=True)


atexit.register(forget_stored)


def local_folder(target: Target, copied_suffixes: Collection[str]) -> Path:
    """The folder `target`, or the one that stands for a URL.

    copied_suffixes: of files that are neither picture nor video, read whole as a capture is opened.
    Raises SwingsError, CaptureError for a capture that no folder can hold.
    """
    if not is_url(target):
        return Path(target)
    store = open_store(str(target), patient=True)
    sizes: dict[str, int] = {}
    for path, size_bytes in store.sizes(""):
        sizes[_checked(store, path)] = size_bytes
        if len(sizes) > MAX_FILES:
            raise CaptureError(f"{store.name}: more than {MAX_FILES} files")
    for folder_of in {str(PurePosixPath(path).parent) for path in sizes}:
        if sizes.get(folder_of) == 0:  # what consoles make of a folder
            del sizes[folder_of]
    if not sizes:
        raise CaptureError(f"{store.name}: no such capture; there are no files below it")
    copied = [path for path in sizes if PurePosixPath(path).suffix.lower() in copied_suffixes]
    copied_bytes = sum(sizes[path] for path in copied)
    if copied_bytes > MAX_COPIED_BYTES:
        raise CaptureError(
            f"{store.name}: {copied_bytes} bytes of tables and points, at most {MAX_COPIED_BYTES}"
        )
    folder = Path(tempfile.mkdtemp(prefix="swings-")) / (store.last_name or "capture")
    stored = _OPENED[folder] = StoredFiles(store, folder, sizes)
    try:
        _fill(stored, copied)
    except OSError as error:
        raise CaptureError(f"{store.name}: {error.filename}: {error.strerror}") from error
    for path in copied:
        del sizes[path]
    return folder


def _checked(store: StorePrefix, path: str) -> str:
    parts = PurePosixPath(path).parts
    if not parts or path.startswith("/") or ".." in parts or "\0" in path:
        raise CaptureError(f"{store.name}: {path!r} cannot be a file of a capture")
    return path


def _fill(stored: StoredFiles, copied: list[str]) -> None:
    for parent in {PurePosixPath(path).parent for path in stored.sizes}:
        (stored.folder / parent).mkdir(parents=True, exist_ok=True)
    for path in stored.sizes.keys() - set(copied):
        (stored.folder / path).touch()

    def copy(path: str) -> None:
        (stored.folder / path).write_bytes(stored.store.read(path, stored.sizes[path]))

    with ThreadPoolExecutor(REQUESTS) as pool:
        for _ in pool.map(copy, copied):
            pass


def _found(path: Path) -> StoredFiles | None:
    if not _OPENED:  # the usual case: no capture of a store is open
        return None
    return next((_OPENED[folder] for folder in (path, *path.parents) if folder in _OPENED), None)


def _stored_name(path: Path) -> tuple[StorePrefix, str, int] | None:
    """The store that holds the bytes of the file at `path`, the file's path there and its size;
    None if they lie on this machine."""
    stored = _found(path)
    if stored is None:
        return None
    name = path.relative_to(stored.folder).as_posix()
    return (stored.store, name, stored.sizes[name]) if name in stored.sizes else None


@contextmanager
def by_its_name(path: Path) -> Iterator[None]:
    """A CaptureError of the block calls a stored file what the user calls it."""
    try:
        yield
    except CaptureError as error:
        stored = _found(path)
        if stored is None:
            raise
        raise stored.renamed(error) from error


@contextmanager
def opened_file(path: Path) -> Iterator[BinaryIO]:
    """The regular file at `path`, to be read. Raises CorruptError if it cannot be."""
    if stored := _stored_name(path):
        store, name, _ = stored
        yield io.BytesIO(store.read(name, MAX_PICTURE_BYTES))
    else:
        with opened_regular(path) as file:
            yield file


class StoredFile(io.RawIOBase):
    """A file of a store: each read is a request."""

    def __init__(self, store: StorePrefix, path: str, size_bytes: int) -> None:
        self._store, self._path, self._size_bytes = store, path, size_bytes
        self._at = 0

    def readable(self) -> bool:
        return True

    def seekable(self) -> bool:
        return True

    def seek(self, offset: int, whence: int = io.SEEK_SET) -> int:
        begin = {io.SEEK_SET: 0, io.SEEK_CUR: self._at, io.SEEK_END: self._size_bytes}[whence]
        self._at = max(0, begin + offset)
        return self._at

    def readinto(self, buffer: Any) -> int:
        """Raises CorruptError."""
        size = min(len(buffer), max(0, self._size_bytes - self._at))
        if size:
            buffer[:size] = self._store.read_range(self._path, self._at, size)
            self._at += size
        return size


def block_file(path: Path) -> io.BufferedReader | None:
    """The file at `path`, read in blocks, if it lies in a store; None if it is a file of this
    machine."""
    # The reader of obstore forgets its block at each seek, and even when asked where it stands.
    stored = _stored_name(path)
    return io.BufferedReader(StoredFile(*stored), BLOCK_BYTES) if stored else None


@contextmanager
def translated() -> Iterator[None]:
    """Translates a store's errors in the block into CaptureError."""
    try:
        yield
    except CodecError as error:
        raise CaptureError(str(error)) from error
