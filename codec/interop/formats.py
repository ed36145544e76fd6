"""The formats of Gaussians that are read and written, by the name and the first bytes of a file."""

from __future__ import annotations

import os
from collections.abc import Callable
from enum import StrEnum
from pathlib import Path

from codec.errors import CodecError, CorruptError, UnsupportedError
from codec.splats import Splats
from codec.stream.writer import write_atomic

from .compressed_ply import decode_compressed_ply, is_compressed
from .limits import MAX_GAUSSIANS
from .ply import decode_ply, encode_ply
from .plyheader import read_ply_elements
from .splat import decode_splat, encode_splat
from .spz import decode_spz, encode_spz

MAX_FILE_BYTES = MAX_GAUSSIANS * 248 + (1 << 20)
"""Longest file read: the most Gaussians as a PLY of SH degree 3."""


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


def decode_any(data: bytes, suffix: str = "", max_gaussians: int = MAX_GAUSSIANS) -> Splats:
    """The Gaussians of a file that begins as a known format, or is called .splat, which has no
    magic.

    Raises CorruptError, or UnsupportedError, which is also for a file that claims more than
    `max_gaussians`: nothing of it is decoded.
    """
    if suffix.lower() == ".splat":
        return decode_splat(data, max_gaussians)
    if data.startswith(b"ply"):
        elements = read_ply_elements(data)
        decode = decode_compressed_ply if is_compressed(elements) else decode_ply
        return decode(data, max_gaussians, elements)
    if data.startswith((b"NGSP", b"\x1f\x8b")):
        return decode_spz(data, max_gaussians)
    raise UnsupportedError(
        f"starts with {data[:4]!r}; this program reads .ply, compressed .ply, .spz and .splat"
    )


def read_splats(path: Path, max_gaussians: int = MAX_GAUSSIANS) -> Splats:
    """The Gaussians of the file at `path`, `max_gaussians` at most. Raises a CodecError that names
    it."""
    try:
        with open(path, "rb") as file:
            # Python takes at once what it is told to read, however short the file is.
            size = os.fstat(file.fileno()).st_size
            data = file.read(min(size, MAX_FILE_BYTES) + 1)
    except OSError as error:
        raise CorruptError(f"{path} cannot be read: {error.strerror}") from error
    if len(data) > MAX_FILE_BYTES:
        raise CorruptError(f"{path} is longer than {MAX_FILE_BYTES} bytes")
    try:
        return decode_any(data, path.suffix, max_gaussians)
    except CodecError as error:
        raise type(error)(f"{path}: {error}") from error


def write_splats(path: Path, splats: Splats, format: SplatFormat) -> int:
    """Puts `splats` at `path`, whole or not at all; gives the bytes written."""
    data = ENCODERS[format](splats)
    write_atomic(path, data)
    return len(data)
