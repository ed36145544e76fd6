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
from collections import OrderedDict
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import BinaryIO

from codec.errors import CodecError
from codec.files import opened_regular
from codec.storage.objectstore import REQUESTS, StorePrefix, open_store
from codec.storage.openstorage import Target, check_url, is_url

from .errors import CaptureError

COPIED_SUFFIXES = frozenset({".json", ".txt", ".npy", ".npz", ".ply", ".bin"})
"""What is neither picture nor video and is read whole as a capture is opened."""

MAX_COPIED_BYTES = 1 << 30
"""Of all of them."""

MAX_FILES = 1 << 22
"""In a capture: more than ten hours of 30 cameras."""

MAX_PICTURE_BYTES = 1 << 28
"""Of one picture's file."""

BLOCK_BYTES = 1 << 20
"""Of a video that are asked for at once."""

KEPT_BLOCKS = 4
"""Of each open video: what its demuxer goes back and forth between."""


@dataclass(frozen=True, slots=True)
class StoredFiles:
    """A capture of a store, and the folder that stands for it."""

    store: StorePrefix
    folder: Path
    sizes: dict[str, int]
    """Of the files that are empty in the folder, in bytes, by their paths."""

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


def local_folder(target: Target) -> Path:
    """The folder `target`, or the one that stands for a URL. Raises SwingsError, CaptureError for a
    capture that no folder can hold."""
    if not is_url(target):
        return Path(target)
    check_url(str(target))
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
    copied = [path for path in sizes if PurePosixPath(path).suffix.lower() in COPIED_SUFFIXES]
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
    if not _OPENED:  # as good as always
        return None
    return next((_OPENED[folder] for folder in (path, *path.parents) if folder in _OPENED), None)


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
    stored = _found(path)
    name = None if stored is None else path.relative_to(stored.folder).as_posix()
    if stored is None or name not in stored.sizes:
        with opened_regular(path) as file:
            yield file
    else:
        yield io.BytesIO(stored.store.read(name, MAX_PICTURE_BYTES))


class BlockFile(io.RawIOBase):
    """A file of a store, read block by block; holds KEPT_BLOCKS of them."""

    def __init__(self, store: StorePrefix, path: str, size_bytes: int) -> None:
        self._store = store
        self._path = path
        self._size_bytes = size_bytes
        self._at = 0
        self._blocks: OrderedDict[int, bytes] = OrderedDict()

    def readable(self) -> bool:
        return True

    def seekable(self) -> bool:
        return True

    def seek(self, offset: int, whence: int = io.SEEK_SET) -> int:
        begin = {io.SEEK_SET: 0, io.SEEK_CUR: self._at, io.SEEK_END: self._size_bytes}[whence]
        self._at = max(0, begin + offset)
        return self._at

    def tell(self) -> int:
        return self._at

    def read(self, size: int = -1) -> bytes:
        """At most `size` bytes, perhaps fewer; none at the end. Raises CorruptError."""
        if size < 0:
            size = self._size_bytes
        if self._at >= self._size_bytes:
            return b""
        number, offset = divmod(self._at, BLOCK_BYTES)
        data = self._block(number)[offset : offset + size]
        self._at += len(data)
        return data

    def _block(self, number: int) -> bytes:
        if number not in self._blocks:
            begin = number * BLOCK_BYTES
            size = min(BLOCK_BYTES, self._size_bytes - begin)
            while len(self._blocks) >= KEPT_BLOCKS:
                self._blocks.popitem(last=False)
            self._blocks[number] = self._store.read_range(self._path, begin, size)
        self._blocks.move_to_end(number)
        return self._blocks[number]


def block_file(path: Path) -> BlockFile | None:
    """The file at `path` if it lies in a store; None if it is a file of this machine."""
    stored = _found(path)
    name = None if stored is None else path.relative_to(stored.folder).as_posix()
    if stored is None or name not in stored.sizes:
        return None
    return BlockFile(stored.store, name, stored.sizes[name])


@contextmanager
def translated() -> Iterator[None]:
    """What a store says in the block is a CaptureError."""
    try:
        yield
    except CodecError as error:
        raise CaptureError(str(error)) from error
