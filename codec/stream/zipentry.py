"""The records of a ZIP file whose entries are stored as they are, without compression.

Rule: pure, and determined: a name, a size, a checksum and a place give one sequence of bytes, in
which every ZIP program finds the entry. ZIP64 appears only where a number does not fit.
"""

from __future__ import annotations

import struct
from collections.abc import Iterable, Iterator
from dataclasses import dataclass

# signature, version needed, flags, method, time, date, CRC-32, size stored, size, name bytes,
# extra bytes
LOCAL = struct.Struct("<IHHHHHIIIHH")
# signature, made by, version needed, flags, method, time, date, CRC-32, size stored, size, name
# bytes, extra bytes, comment bytes, disk, internal attributes, external attributes, place
CENTRAL = struct.Struct("<IHHHHHHIIIHHHHHII")
# header, bytes, place
PLACE_EXTRA = struct.Struct("<HHQ")
# signature, bytes that follow, made by, version needed, disk, disk of the directory, entries of
# the disk, entries, directory's bytes, directory's place
END_64 = struct.Struct("<IQHHIIQQQQ")
# signature, disk of the record above, its place, disks
LOCATOR_64 = struct.Struct("<IIQI")
# signature, disk, disk of the directory, entries of the disk, entries, directory's bytes,
# directory's place, comment bytes
END = struct.Struct("<IHHHHIIH")
assert LOCAL.size == 30
assert CENTRAL.size == 46
assert (END_64.size, LOCATOR_64.size, END.size) == (56, 20, 22)

LOCAL_MAGIC = 0x04034B50
CENTRAL_MAGIC = 0x02014B50
END_64_MAGIC = 0x06064B50
LOCATOR_64_MAGIC = 0x07064B50
END_MAGIC = 0x06054B50

MOST_32 = 0xFFFFFFFF
"""A place or size from here on stands in a ZIP64 record instead."""
MOST_16 = 0xFFFF

_STORED_VERSION = 10
_ZIP64_VERSION = 45
_UTF8_NAME = 0x0800
_FIRST_DATE = 0x0021  # 1 January 1980: equal streams make equal files
_UNIX = 3 << 8
_PLAIN_FILE = 0o100644 << 16


@dataclass(frozen=True, slots=True)
class ZipEntry:
    """A file in a ZIP file."""

    name: str
    size_bytes: int
    """Below 2^32 - 1."""
    crc32: int
    header_at: int
    """Where its local header begins, which its bytes follow."""

    @property
    def utf8_name(self) -> bytes:
        return self.name.encode()


def local_bytes(name: str, extra_bytes: int = 0) -> int:
    """The size of the local header of an entry called `name`."""
    return LOCAL.size + len(name.encode()) + extra_bytes


def local_header(entry: ZipEntry, extra: bytes = b"") -> bytes:
    """The header before the bytes of `entry`."""
    name = entry.utf8_name
    return LOCAL.pack(LOCAL_MAGIC, *_fields(entry, _STORED_VERSION, extra)) + name + extra


def _fields(entry: ZipEntry, version: int, extra: bytes) -> tuple[int, ...]:
    """What both headers of an entry say of it, from the version needed to the extra field."""
    sizes = entry.size_bytes, entry.size_bytes
    lengths = len(entry.utf8_name), len(extra)
    return version, _UTF8_NAME, 0, 0, _FIRST_DATE, entry.crc32, *sizes, *lengths


def _central_header(entry: ZipEntry) -> bytes:
    name, is_far = entry.utf8_name, entry.header_at >= MOST_32
    extra = PLACE_EXTRA.pack(1, 8, entry.header_at) if is_far else b""
    version = _ZIP64_VERSION if is_far else _STORED_VERSION
    head = CENTRAL.pack(
        CENTRAL_MAGIC,
        _UNIX | version,
        *_fields(entry, version, extra),
        0,
        0,
        0,
        _PLAIN_FILE,
        min(entry.header_at, MOST_32),
    )
    return head + name + extra


def directory(entries: Iterable[ZipEntry], begin: int) -> Iterator[bytes]:
    """The end of a ZIP file, piece by piece: the directory of `entries`, which begins at `begin`,
    and the records that lead to it."""
    count = size_bytes = 0
    for entry in entries:
        header = _central_header(entry)
        count, size_bytes = count + 1, size_bytes + len(header)
        yield header
    if _needs_64(count, size_bytes, begin):
        version = _ZIP64_VERSION
        rest = END_64.size - 12
        counts = 0, 0, count, count
        yield END_64.pack(END_64_MAGIC, rest, version, version, *counts, size_bytes, begin)
        yield LOCATOR_64.pack(LOCATOR_64_MAGIC, 0, begin + size_bytes, 1)
    shown, place = min(count, MOST_16), min(begin, MOST_32)
    yield END.pack(END_MAGIC, 0, 0, shown, shown, min(size_bytes, MOST_32), place, 0)


def directory_bytes(count: int, names_bytes: int, num_far: int, begin: int) -> int:
    """The size of `directory`. names_bytes: of all `count` names together. num_far: entries whose
    header begins at or after MOST_32."""
    size_bytes = count * CENTRAL.size + names_bytes + num_far * PLACE_EXTRA.size
    is_64 = _needs_64(count, size_bytes, begin)
    return size_bytes + END.size + is_64 * (END_64.size + LOCATOR_64.size)


def _needs_64(count: int, size_bytes: int, begin: int) -> bool:
    return count >= MOST_16 or size_bytes >= MOST_32 or begin >= MOST_32
