"""The text header of a PLY file: which elements follow, and how their rows are laid out.

Source: "The PLY Polygon File Format" (G. Turk, 1994). Only `binary_little_endian` with scalar
properties is read, which is what every writer of Gaussians gives.
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

    def rows(self, data: bytes) -> npt.NDArray[np.void]:
        """(count,) structured rows, a view into `data`. Raises CorruptError if they are cut off."""
        if not self.properties:
            raise CorruptError(f"PLY: element {self.name[:40]} has no properties")
        end = self.offset + self.count * self.dtype.itemsize
        if len(data) < end:
            raise CorruptError(
                f"PLY: ends after {len(data)} bytes; the {self.count} rows of {self.name[:40]} "
                f"need {end}"
            )
        return np.frombuffer(data, self.dtype, self.count, self.offset)


def _header_lines(data: bytes) -> tuple[list[str], int]:
    """The lines up to end_header, and how many bytes they take."""
    head = data[:MAX_HEADER_BYTES]
    if not head.startswith((b"ply\n", b"ply\r\n")):
        raise CorruptError("PLY: does not start with a line `ply`")
    at = head.find(b"\n" + _END)
    newline = head.find(b"\n", at + 1) if at >= 0 else -1
    if newline < 0:
        raise CorruptError(f"PLY: no end_header in the first {len(head)} bytes")
    try:
        text = head[:newline].decode("utf-8")
    except UnicodeDecodeError as error:
        raise CorruptError("PLY: the header is no text") from error
    lines = [line.rstrip("\r") for line in text.split("\n")]
    if lines[-1].strip() != _END.decode():
        raise CorruptError(f"PLY: header line {lines[-1][:40]!r}")
    return lines[1:-1], newline + 1


def _count(text: str, name: str) -> int:
    if not (text.isascii() and text.isdigit() and len(text) <= 18):
        raise CorruptError(f"PLY: element {name[:40]} of {text[:40]!r} rows")
    return check_count("PLY", int(text))


def read_ply_elements(data: bytes) -> dict[str, PlyElement]:
    """The elements of the PLY file `data` by name, in the order of the file.

    Raises CorruptError, or UnsupportedError for text, big-endian, or a list among the properties.
    """
    lines, offset = _header_lines(data)
    found: list[tuple[str, int, list[tuple[str, str]]]] = []
    layout = "none"
    for line in lines:
        words = line.split()
        match words:
            case [] | ["comment" | "obj_info", *_]:
                pass
            case ["format", kind, _]:
                layout = kind
            case ["element", name, rows]:
                found.append((name, _count(rows, name), []))
            case ["property", "list", *_]:
                raise UnsupportedError("PLY: a list among the properties; this is a mesh")
            case ["property", kind, name] if found and kind in _TYPES:
                found[-1][2].append((name, _TYPES[kind]))
            case _:
                raise CorruptError(f"PLY: header line {line[:40]!r}")
    if layout != "binary_little_endian":
        raise UnsupportedError(
            f"PLY: format {layout[:40]!r}; this program reads binary_little_endian"
        )
    elements: dict[str, PlyElement] = {}
    for name, count, properties in found:
        try:
            dtype = np.dtype(properties)
        except ValueError as error:
            raise CorruptError(f"PLY: element {name[:40]} names a property twice") from error
        if name in elements:
            raise CorruptError(f"PLY: two elements are called {name[:40]}")
        elements[name] = PlyElement(name, count, offset, dtype)
        offset += count * dtype.itemsize
    return elements
