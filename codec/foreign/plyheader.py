"""The text header of a PLY file: which elements follow, and how their rows are laid out.

Source: "The PLY Polygon File Format" (G. Turk, 1994). Every writer of Gaussians gives rows of
numbers in `binary_little_endian`, and these are read here. A caller that also takes text or meshes
reads their rows itself, as trainer/capture/points.py does.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from codec.errors import CorruptError, UnsupportedError

from .limits import check_count

MAX_HEADER_BYTES = 1 << 16
"""Longest header read: one of 62 properties has about 1.5 KB."""

_TYPES = {
    **dict.fromkeys(("char", "int8"), "<i1"),
    **dict.fromkeys(("uchar", "uint8"), "<u1"),
    **dict.fromkeys(("short", "int16"), "<i2"),
    **dict.fromkeys(("ushort", "uint16"), "<u2"),
    **dict.fromkeys(("int", "int32"), "<i4"),
    **dict.fromkeys(("uint", "uint32"), "<u4"),
    **dict.fromkeys(("float", "float32"), "<f4"),
    **dict.fromkeys(("double", "float64"), "<f8"),
}
_END = b"end_header"
BINARY, TEXT = "binary_little_endian", "ascii"


@dataclass(frozen=True, slots=True)
class PlyElement:
    """A table of `count` rows that starts `offset` bytes into the file."""

    name: str
    count: int
    offset: int
    dtype: np.dtype[np.void]

    @property
    def properties(self) -> tuple[str, ...]:
        return self.dtype.names or ()

    @property
    def end(self) -> int:
        """Where the rows end, as an offset into the file."""
        return self.offset + self.count * self.dtype.itemsize

    def check_size(self, file_bytes: int) -> None:
        """Raises CorruptError if a file of `file_bytes` ends before the rows do."""
        if file_bytes < self.end:
            raise CorruptError(
                f"PLY: ends after {file_bytes} bytes; the {self.count} rows of {self.name[:40]} "
                f"need {self.end}"
            )

    def rows(self, data: bytes) -> npt.NDArray[np.void]:
        """(count,) structured rows, a view into `data`. Raises CorruptError if they are cut off."""
        if not self.properties:
            raise CorruptError(f"PLY: element {self.name[:40]} has no properties")
        self.check_size(len(data))
        return np.frombuffer(data, self.dtype, self.count, self.offset)


@dataclass(frozen=True, slots=True)
class PlyHeader:
    """Elements and properties of the header; the counts are claims."""

    layout: str
    """How the rows are written: BINARY, TEXT, or what else it says."""
    tables: dict[str, PlyElement]
    """The elements before the first with a list, by name and in order. Where they begin is right
    for binary rows, and for the first of all in any layout."""
    has_list: bool
    """Whether there is a list. Its rows have lengths of their own, so nothing behind it has a fixed
    place."""
    comments: tuple[str, ...] = ()
    """The text of each comment."""

    def check_rows(self) -> None:
        """Raises CorruptError, or UnsupportedError, if the rows cannot be read as arrays."""
        for element in self.tables.values():
            check_count("PLY", element.count)
        if self.has_list:
            raise UnsupportedError("PLY: a list among the properties; this is a mesh")
        if self.layout != BINARY:
            raise UnsupportedError(f"PLY: format {self.layout[:40]!r}; this program reads {BINARY}")


def _header_lines(data: bytes) -> tuple[list[str], int]:
    """The lines up to end_header, and how many bytes they take."""
    head = data[:MAX_HEADER_BYTES]
    # Old programs end lines with \r alone.
    newline = b"\n" if b"\n" in head.partition(_END)[0] else b"\r"
    if head.partition(newline)[0].split() != [b"ply"]:
        raise CorruptError("PLY: does not start with a line `ply`")
    at = head.find(newline + _END)
    end = head.find(newline, at + 1) if at >= 0 else -1
    if end < 0:
        raise CorruptError(f"PLY: no end_header in the first {len(head)} bytes")
    try:
        lines = head[:end].decode("utf-8").split(newline.decode())
    except UnicodeDecodeError as error:
        raise CorruptError("PLY: the header is not text") from error
    if lines[-1].strip() != _END.decode():
        raise CorruptError(f"PLY: header line {lines[-1][:40]!r}")
    return lines[1:-1], end + 1


def _count(text: str, name: str) -> int:
    if not (text.isascii() and text.isdigit() and len(text) <= 18):
        raise CorruptError(f"PLY: element {name[:40]} has {text[:40]!r} rows, which is not a count")
    return int(text)


def read_ply_header(data: bytes) -> PlyHeader:
    """The header of the PLY file that begins with `data`, of which MAX_HEADER_BYTES are looked at.

    Raises CorruptError.
    """
    lines, offset = _header_lines(data)
    layout = "none"
    first_list: int | None = None
    found: list[tuple[str, int, list[tuple[str, str]]]] = []
    comments: list[str] = []
    for line in lines:
        match line.split():
            case ["comment", *words]:
                comments.append(" ".join(words))
            case [] | ["obj_info", *_]:
                pass
            case ["format", kind, *_]:
                layout = kind
            case ["element", name, rows]:
                found.append((name, _count(rows, name), []))
            case ["property", "list", *_] if found:
                first_list = len(found) - 1 if first_list is None else first_list
            case ["property", kind, name] if found and kind in _TYPES:
                found[-1][2].append((name, _TYPES[kind]))
            case _:
                raise CorruptError(f"PLY: header line {line[:40]!r}")
    tables: dict[str, PlyElement] = {}
    for name, count, properties in found:
        try:
            dtype = np.dtype(properties)
        except ValueError as error:
            raise CorruptError(f"PLY: element {name[:40]} names a property twice") from error
        if name in tables:
            raise CorruptError(f"PLY: two elements are called {name[:40]}")
        tables[name] = PlyElement(name, count, offset, dtype)
        offset += count * dtype.itemsize
    before_list = dict(list(tables.items())[:first_list])
    return PlyHeader(layout, before_list, first_list is not None, tuple(comments))
