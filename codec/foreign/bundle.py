"""A few files in one: ZIP archives (PKWARE's APPNOTE), stored or deflated, of bounded size."""

from __future__ import annotations

import io
import struct
import zipfile
import zlib
from collections.abc import Mapping

from codec.errors import CorruptError, UnsupportedError

MAGIC = b"PK\3\4"
END = struct.Struct("<4s4H2IH")
END_MAGIC, LONG_MAGIC = b"PK\5\6", b"PK\6\7"
LONG_BYTES = 20
"""Size of the record before the end that points to a longer one, for more than 4 GB."""
MAX_COMMENT_BYTES = 0xFFFF
MAX_DIRECTORY_BYTES = 1 << 16
"""Largest table of contents. That of a few files has less than a kilobyte; every 46 bytes become a
Python object."""
FILE_SLACK_BYTES = 1 << 20
"""By how much a file may be longer than the archive: only text shrinks much."""
_BROKEN = (
    *(zipfile.BadZipFile, zipfile.LargeZipFile, zlib.error, struct.error),
    *(OSError, EOFError, ValueError, RuntimeError, LookupError),
)


class Bundle:
    """The archive `data`, called `what` in errors."""

    def __init__(self, data: bytes, what: str) -> None:
        """Raises CorruptError, or UnsupportedError."""
        self._what = what
        self.num_bytes = len(data)
        """Size of the archive."""
        self._max_bytes = len(data) + FILE_SLACK_BYTES
        _check_end(data, what)
        try:
            self._archive = zipfile.ZipFile(io.BytesIO(data))
        except _BROKEN as error:
            raise CorruptError(f"{what}: the ZIP archive is broken: {error}") from error

    def read(self, name: str) -> bytes:
        """The file called `name`. Raises CorruptError, or UnsupportedError."""
        shown = f"{self._what}: {name[:40]!r}"
        try:
            info = self._archive.getinfo(name)
        except KeyError as error:
            raise CorruptError(f"{shown} is not in the archive") from error
        if info.flag_bits & 1 or info.compress_type not in (
            zipfile.ZIP_STORED,
            zipfile.ZIP_DEFLATED,
        ):
            raise UnsupportedError(f"{shown} is encrypted, or packed in a way not read here")
        if info.file_size > self._max_bytes:
            raise CorruptError(f"{shown} claims {info.file_size} bytes, at most {self._max_bytes}")
        try:
            with self._archive.open(info) as file:
                return file.read(self._max_bytes)
        except _BROKEN as error:
            raise CorruptError(f"{shown} is broken: {error}") from error


def _check_end(data: bytes, what: str) -> None:
    """Raises an error for an archive whose table of contents is too long to be looked at."""
    # As zipfile looks for it: at the very end, else before a comment.
    at = len(data) - END.size
    if at < 0 or data[at : at + 4] != END_MAGIC or data[-2:] != b"\0\0":
        at = data.rfind(END_MAGIC, max(0, len(data) - END.size - MAX_COMMENT_BYTES))
    if at < 0 or len(data) < at + END.size:
        raise CorruptError(f"{what}: ends inside the ZIP archive")
    if data[max(0, at - LONG_BYTES) : at].startswith(LONG_MAGIC):
        raise UnsupportedError(f"{what}: a ZIP archive with records for more than 4 GB")
    directory_bytes = END.unpack_from(data, at)[5]
    if directory_bytes > MAX_DIRECTORY_BYTES:
        raise CorruptError(
            f"{what}: {directory_bytes} bytes of names in the ZIP archive, "
            f"at most {MAX_DIRECTORY_BYTES}"
        )


def encode_bundle(files: Mapping[str, bytes]) -> bytes:
    """The archive of `files`, stored as they are; the same bytes whenever it is made."""
    made = io.BytesIO()
    with zipfile.ZipFile(made, "w") as archive:
        for name, data in files.items():
            info = zipfile.ZipInfo(name)  # of the first day that ZIP knows
            info.create_system = 3
            info.external_attr = 0o644 << 16
            archive.writestr(info, data)
    return made.getvalue()
