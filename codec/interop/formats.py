"""The formats of Gaussians that are read and written, by the name and the first bytes of a file."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path

from codec.errors import CodecError, UnsupportedError
from codec.files import read_bounded, read_head, write_atomic
from codec.foreign.compressed_ply import compressed_layout, decode_compressed_ply, is_compressed
from codec.foreign.limits import MAX_GAUSSIANS
from codec.foreign.ply import decode_ply, encode_ply, ply_layout
from codec.foreign.plyheader import MAX_HEADER_BYTES, read_ply_elements
from codec.foreign.splat import decode_splat, encode_splat, splat_count
from codec.foreign.spz import decode_spz, encode_spz, spz_header
from codec.splats import Splats

HEAD_BYTES = MAX_HEADER_BYTES
"""What is read of a file before the rest; the other formats have shorter headers than PLY."""
MAX_FILE_BYTES = MAX_GAUSSIANS * 248 + (1 << 20)
"""Longest file read: the most Gaussians as a PLY of SH degree 3, 248 bytes each."""


class SplatFormat(StrEnum):
    """What can be written."""

    PLY = "ply"
    SPLAT = "splat"
    SPZ = "spz"


ENCODERS: dict[SplatFormat, Callable[[Splats], bytes]] = {
    SplatFormat.PLY: encode_ply,
    SplatFormat.SPLAT: encode_splat,
    SplatFormat.SPZ: encode_spz,
}


def has_known_suffix(path: Path) -> bool:
    """Whether the name of `path` ends like a file of Gaussians."""
    return path.suffix.lower().removeprefix(".") in set(SplatFormat)


@dataclass(frozen=True, slots=True)
class _Reading:
    """How a format is read."""

    check: Callable[[bytes, int, int], object]
    """Given the first bytes of a file, its size, and the most Gaussians: raises for a file that
    `decode` would not take, as far as they tell."""
    decode: Callable[[bytes, int], Splats]


_SPLAT = _Reading(lambda _, file_bytes, most: splat_count(file_bytes, most), decode_splat)
_COMPRESSED_PLY = _Reading(compressed_layout, decode_compressed_ply)
_PLY = _Reading(ply_layout, decode_ply)
_SPZ = _Reading(spz_header, decode_spz)


def _reading(head: bytes, suffix: str) -> _Reading:
    """How to read a file that begins with `head`. Raises a CodecError if that is unknown."""
    if suffix.lower() == ".splat":
        return _SPLAT
    if head.startswith(b"ply"):
        return _COMPRESSED_PLY if is_compressed(read_ply_elements(head)) else _PLY
    if head.startswith((b"NGSP", b"\x1f\x8b")):
        return _SPZ
    raise UnsupportedError(
        f"starts with {head[:4]!r}; this program reads .ply, compressed .ply, .spz and .splat"
    )


def decode_any(data: bytes, suffix: str = "", max_gaussians: int = MAX_GAUSSIANS) -> Splats:
    """The Gaussians of a file that begins as a known format, or is called .splat, which has no
    magic.

    Raises CorruptError, or UnsupportedError, which is also for a file that claims more than
    `max_gaussians`: nothing of it is decoded.
    """
    return _reading(data, suffix).decode(data, max_gaussians)


def read_splats(path: Path, max_gaussians: int = MAX_GAUSSIANS) -> Splats:
    """The Gaussians of the file at `path`, at most `max_gaussians`.

    Raises a CodecError that names the file. One that its size or its first bytes rule out is not
    read any further.
    """
    head, file_bytes = read_head(path, HEAD_BYTES)
    try:
        reading = _reading(head, path.suffix)
        reading.check(head, file_bytes, max_gaussians)
    except CodecError as error:
        raise error.within(path) from error
    data = read_bounded(path, MAX_FILE_BYTES)
    try:
        return reading.decode(data, max_gaussians)
    except CodecError as error:
        raise error.within(path) from error


def write_splats(path: Path, splats: Splats, format: SplatFormat) -> int:
    """Puts `splats` at `path`, whole or not at all; gives the bytes written."""
    data = ENCODERS[format](splats)
    write_atomic(path, data)
    return len(data)
