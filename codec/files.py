"""Files that are whole or absent: the one way in which everything here is written.

Rule: what is being written has a temporary name that begins with a dot, beside its place; it takes
its name by a rename once all of it is on the disk.
"""

from __future__ import annotations

import errno
import os
import shutil
import stat
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import BinaryIO

from .errors import CorruptError, InvalidError, UnreadableError
from .outputlock import writing_alone

DISK_ERRORS = {errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EIO, errno.EROFS}
"""Error numbers of a write to a disk that is full, broken or read-only."""

Opener = Callable[[str, int], int]
"""Gives the descriptor of the file at a path, opened with flags of `os`."""


def sync_folder(path: Path) -> None:
    """Makes the names in the folder `path` last through a power cut. Does nothing on Windows,
    where folders cannot be opened."""
    if sys.platform == "win32":
        return
    descriptor = os.open(path, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def temporary_beside(path: Path) -> Path:
    """Where to make what is to be renamed to `path`. Raises InvalidError if that names nothing."""
    try:
        return path.with_name(f".{path.name}.tmp")
    except ValueError as error:
        raise InvalidError(f"{path} names no file or folder to write; give it a name") from error


def name_file(error: BaseException, path: Path | str) -> None:
    """Has `error`, if it is one of a full or broken disk and names no file, name `path`."""
    if isinstance(error, OSError) and error.filename is None and error.errno in DISK_ERRORS:
        error.filename = str(path)


def describe_os_error(error: OSError) -> str:
    """`error` in one line, which begins with the file if `error` names one."""
    if error.filename is None or error.strerror is None or isinstance(error.filename, int):
        return str(error)
    verb = " cannot be written" if error.errno in DISK_ERRORS else ""
    return f"{os.fsdecode(error.filename)}{verb}: {error.strerror}"


def put_in_place(temporary: Path, path: Path) -> None:
    """Renames the finished file `temporary` to `path`, both of one folder, so that it lasts."""
    with open(temporary, "r+b") as file:  # Windows syncs only what may be written
        os.fsync(file.fileno())
    os.replace(temporary, path)
    sync_folder(path.parent)


@contextmanager
def replacing(path: Path) -> Iterator[Path]:
    """Gives the temporary file to write; leaving normally puts it at `path`.

    A reader sees all of it or what was there before. Leaving by an exception removes it; that of a
    full or broken disk, which names no file by itself, names `path` then.
    """
    temporary = temporary_beside(path)
    try:
        yield temporary
        put_in_place(temporary, path)
    except BaseException as error:
        with suppress(OSError):
            temporary.unlink(missing_ok=True)
        if isinstance(error, OSError) and error.filename in (str(temporary), temporary):
            error.filename = str(path)
        name_file(error, path)
        raise


def write_atomic(path: Path, data: bytes) -> None:
    """Puts `data` at `path`, see `replacing`."""
    with replacing(path) as temporary:
        temporary.write_bytes(data)


@contextmanager
def making_folder(path: Path) -> Iterator[Path]:
    """Gives a new folder beside `path` to fill; leaving normally puts it at `path`, which must be
    absent or an empty folder.

    Leaving by an exception removes it, and what it says of files in it, it says of `path`. What a
    killed process left is removed by the next one. Raises InvalidError, and ConflictError if
    another process is making it.
    """
    temporary = temporary_beside(path)
    path.parent.mkdir(parents=True, exist_ok=True)
    with writing_alone(path):
        if path.exists() and not (path.is_dir() and not any(path.iterdir())):
            raise InvalidError(f"{path} is not empty; remove it or name another folder")
        try:
            if temporary.exists():
                shutil.rmtree(temporary)
            temporary.mkdir()
            yield temporary
            temporary.rename(path)
            sync_folder(path.parent)
        except BaseException as error:
            shutil.rmtree(temporary, ignore_errors=True)
            if isinstance(error, OSError) and error.filename is not None:
                inside = Path(os.fsdecode(error.filename))
                if inside.is_relative_to(temporary):
                    error.filename = str(path / inside.relative_to(temporary))
            raise


@contextmanager
def temporary_folder(path: Path) -> Iterator[Path]:
    """Gives a new folder beside the file at `path`, for what the file is made of; leaving removes
    it. What a killed process left is removed by the next one. Raises ConflictError if another
    process is writing `path`."""
    temporary = path.with_name(f".{path.name}.parts")
    path.parent.mkdir(parents=True, exist_ok=True)
    with writing_alone(path):
        shutil.rmtree(temporary, ignore_errors=True)
        try:
            temporary.mkdir()
            yield temporary
        except OSError as error:
            if error.filename is not None and str(temporary) in os.fsdecode(error.filename):
                error.filename = str(path)
            raise
        finally:
            shutil.rmtree(temporary, ignore_errors=True)


def append_durably(path: Path, size_bytes: int, data: bytes) -> None:
    """Appends `data` to the file at `path`, which has `size_bytes`: all of it, or it raises."""
    with open(path, "ab", buffering=0) as file:
        found_bytes = os.fstat(file.fileno()).st_size
        if found_bytes < size_bytes:
            raise CorruptError(f"{path} has {found_bytes} bytes, not the {size_bytes} written")
        try:
            # A failed call before may have been unable to take back what it wrote.
            file.truncate(size_bytes)
            rest = memoryview(data)
            while rest:  # a full disk takes a part and fails only when asked again
                rest = rest[file.write(rest) :]
            os.fsync(file.fileno())
        except BaseException as error:
            with suppress(OSError):
                file.truncate(size_bytes)
            name_file(error, path)
            raise


def open_without_waiting(path: str, flags: int) -> int:
    """An `Opener` for files of strangers, which does not wait for the other end of a pipe."""
    if sys.platform == "win32":  # where pipes have no paths among files
        return os.open(path, flags)
    return os.open(path, flags | os.O_NONBLOCK)


@contextmanager
def opened_regular(
    path: Path, opener: Opener | None = None, if_missing: str | None = None
) -> Iterator[BinaryIO]:
    """The regular file at `path`, to be read. Raises CorruptError if it cannot be; never waits for
    the writer of a pipe."""
    try:
        with open(path, "rb", opener=opener or open_without_waiting) as file:
            if not stat.S_ISREG(os.fstat(file.fileno()).st_mode):
                raise CorruptError(f"{path} cannot be read: it is not a regular file")
            yield file
    except (FileNotFoundError, NotADirectoryError) as error:
        meaning = "" if if_missing is None else f"; {if_missing}"
        raise CorruptError(f"{path} is missing{meaning}") from error
    except IsADirectoryError as error:
        raise CorruptError(f"{path} cannot be read: {error.strerror}") from error
    except OSError as error:
        raise UnreadableError(f"{path} cannot be read: {error.strerror or error}") from error


def read_bounded(
    path: Path,
    limit_bytes: int,
    offset: int = 0,
    *,
    if_missing: str | None = None,
    opener: Opener = open_without_waiting,
) -> bytes:
    """The regular file at `path` from `offset` on.

    Raises CorruptError if it cannot be read, or if that is more than `limit_bytes`. `if_missing`
    explains to the user what a missing file means.
    """
    with opened_regular(path, opener, if_missing) as file:
        # Python allocates as much as it is asked to read, however short the file is.
        size = max(os.fstat(file.fileno()).st_size - offset, 0)
        file.seek(offset)
        data = file.read(size + 1) if size <= limit_bytes else None
    if data is None or len(data) > limit_bytes:
        raise CorruptError(f"{path} is longer than {limit_bytes} bytes")
    return data


def read_part(
    path: Path, offset: int, size_bytes: int, *, opener: Opener = open_without_waiting
) -> bytes:
    """`size_bytes` bytes of the regular file at `path`, from `offset` on.

    Raises CorruptError if it cannot be read, or ends before them.
    """
    with opened_regular(path, opener) as file:
        # Python allocates as much as it is asked to read, however short the file is.
        left = max(os.fstat(file.fileno()).st_size - offset, 0)
        file.seek(offset)
        data = file.read(min(size_bytes, left))
    if len(data) != size_bytes:
        raise CorruptError(f"{path} ends before byte {offset + size_bytes}; was it replaced?")
    return data


def read_head(path: Path, head_bytes: int) -> tuple[bytes, int]:
    """The first bytes of the regular file at `path`, `head_bytes` at most, and how many it has.

    Raises CorruptError if it cannot be read.
    """
    with opened_regular(path) as file:
        return file.read(head_bytes), os.fstat(file.fileno()).st_size
