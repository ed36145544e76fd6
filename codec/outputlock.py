"""One writer of an output at a time.

The lock is a `flock` on the file `.NAME.lock` beside the output, which names its holder. The kernel
takes it back when the holder ends, however that comes about, so a file that a killed process left
locks nothing. Readers do not look at it. Object stores have a rule of their own (see
codec/storage/growingstore); Windows has no `flock`, and nothing is locked there.
"""

from __future__ import annotations

import errno
import logging
import os
import socket
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path

from .errors import ConflictError, InvalidError

_log = logging.getLogger(__name__)


@dataclass(slots=True)
class _Hold:
    """The lock of an output that this process holds."""

    descriptor: int | None
    """Of the file that is locked; None where there are no locks."""
    times: int = 0
    """How often it is held: an edit locks what it makes, and so does the folder that it makes."""


_held: dict[Path, _Hold] = {}
_guard = threading.Lock()
"""Of `_held`."""

NO_LOCKS = {errno.ENOLCK, errno.ENOSYS, errno.ENOTSUP, errno.EOPNOTSUPP}
"""Error numbers of a disk that has no locks."""


@contextmanager
def writing_alone(output: Path) -> Iterator[None]:
    """Holds the lock of the file or folder `output`, which may be absent; where the folder around
    it is, too, nothing is locked.

    The process that holds it may do so again. Raises ConflictError at once if another one does.
    """
    key = output.resolve()
    with _guard:
        if key not in _held:
            _held[key] = _Hold(_locked(output, key))
        hold = _held[key]
        hold.times += 1
    try:
        yield
    finally:
        with _guard:
            hold.times -= 1
            if not hold.times:
                del _held[key]
                _unlock(hold.descriptor, key)


def _lock_file(key: Path) -> Path:
    if not key.name:
        raise InvalidError(f"{key} names no file or folder to write; give it a name")
    return key.with_name(f".{key.name}.lock")


def _locked(output: Path, key: Path) -> int | None:
    """The descriptor of what stands for `output`, locked; None where there are no locks. key:
    `output` without links."""
    if sys.platform == "win32" or not key.parent.is_dir():
        return None
    import fcntl

    file = _lock_file(key)
    while True:
        descriptor = _opened(file, key)
        if descriptor is None:
            return None
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
            if _is_at(descriptor, file) or _is_at(descriptor, key):
                break
            os.close(descriptor)  # its holder has removed it; the next one is another file
        except OSError as error:
            holder = os.pread(descriptor, 300, 0) if _is_at(descriptor, file) else b""
            os.close(descriptor)
            if isinstance(error, BlockingIOError):
                raise _conflict(output, holder.decode(errors="replace")) from error
            if error.errno not in NO_LOCKS:
                raise
            _log.warning("%s: its disk has no locks; run only one writer of it", output)
            return None
    if _is_at(descriptor, file):
        with suppress(OSError):  # of a full disk, which the writer finds out by itself
            os.ftruncate(descriptor, 0)
            os.pwrite(descriptor, f"{os.getpid()} {socket.gethostname()}\n".encode(), 0)
    return descriptor


def _opened(file: Path, key: Path) -> int | None:
    """The lock file; where none can be made beside the output, as beside a mounted volume, the
    folder itself. None where there is none: then the output cannot be made either, and its writer
    says why."""
    try:
        return os.open(file, os.O_RDWR | os.O_CREAT, 0o666)
    except OSError:
        return os.open(key, os.O_RDONLY) if key.is_dir() else None


def _is_at(descriptor: int, path: Path) -> bool:
    try:
        return os.path.samestat(os.fstat(descriptor), os.stat(path))
    except FileNotFoundError:
        return False


def _conflict(output: Path, holder: str) -> ConflictError:
    """holder: what the lock file says, which may be nothing yet."""
    pid, _, host = holder.strip().partition(" ")
    elsewhere = "" if host in ("", socket.gethostname()) else f" on {host}"
    who = f"process {pid}{elsewhere}" if pid else "another process"
    return ConflictError(f"{output} is being written by {who}; wait for it, or name another place")


def _unlock(descriptor: int | None, key: Path) -> None:
    if descriptor is None:
        return
    file = _lock_file(key)
    if _is_at(descriptor, file):
        file.unlink(missing_ok=True)  # while it is locked: who has opened it sees that it is gone
    os.close(descriptor)
