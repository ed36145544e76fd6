"""The formats of Gaussians that are read and written, by the name and the first bytes of a file."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from enum import StrEnum
from functools import partial
from pathlib import Path

from codec.errors import CodecError, CorruptError, InvalidError, UnsupportedError
from codec.files import read_bounded, read_head, write_atomic
from codec.foreign.bundle import MAGIC as ZIP_MAGIC
from codec.foreign.compressed_ply import compressed_layout, decode_compressed_ply, is_compressed
from codec.foreign.gltf import decode_gltf, encode_glb, encode_gltf
from codec.foreign.gltfbuffers import Beside, check_glb, is_gltf, nothing_beside
from codec.foreign.ksplat import decode_ksplat, ksplat_count
from codec.foreign.limits import MAX_GAUSSIANS
from codec.foreign.notes import reading
from codec.foreign.ply import decode_ply, encode_ply, ply_layout
from codec.foreign.plyheader import MAX_HEADER_BYTES, read_ply_header
from codec.foreign.sog import META, decode_sog, decode_sog_folder, encode_sog, is_sog_folder
from codec.foreign.splat import decode_splat, encode_splat, splat_count
from codec.foreign.spz import SpzVersion, decode_spz, encode_spz, spz_header
from codec.splats import Splats

HEAD_BYTES = MAX_HEADER_BYTES
"""Bytes of a file that are read first; the headers of formats other than PLY are shorter."""
MAX_FILE_BYTES = MAX_GAUSSIANS * 248 + (1 << 20)
"""Longest file read: the most Gaussians as a PLY of SH degree 3, 248 bytes each."""
READ = ".ply, compressed .ply, .spz, .splat, .ksplat, .sog, .glb and .gltf"
"""The files that are read, in words."""
STREAMED_META = "lod-meta.json"
"""What a streamed SOG begins with."""
SPLAT, KSPLAT = ".splat", ".ksplat"
"""Names of formats that have no magic."""


class SplatFormat(StrEnum):
    """Formats that can be written."""

    PLY = "ply"
    SPLAT = "splat"
    SPZ = "spz"
    SOG = "sog"
    GLB = "glb"
    GLTF = "gltf"


ENCODERS: dict[SplatFormat, Callable[[Splats], bytes]] = {
    SplatFormat.PLY: encode_ply,
    SplatFormat.SPLAT: encode_splat,
    SplatFormat.SPZ: encode_spz,
    SplatFormat.SOG: encode_sog,
    SplatFormat.GLB: encode_glb,
    SplatFormat.GLTF: encode_gltf,
}


def has_known_suffix(path: Path) -> bool:
    """Whether the name of `path` ends like a file of Gaussians."""
    suffix = path.suffix.lower()
    return suffix == KSPLAT or suffix.removeprefix(".") in set(SplatFormat)


def is_model_folder(path: Path) -> bool:
    """Whether `path` is a folder whose files are one model: an unbundled SOG, or what a trainer of
    3D Gaussian Splatting leaves."""
    begins = is_sog_folder(path) or (path / STREAMED_META).is_file()
    return begins or trained_ply(path) is not None


def trained_ply(folder: Path) -> Path | None:
    """`folder`/point_cloud/iteration_N/point_cloud.ply of the highest N; None if there is none."""
    found = {
        int(path.parent.name.rpartition("_")[2]): path
        for path in folder.glob("point_cloud/iteration_*/point_cloud.ply")
        if path.parent.name.removeprefix("iteration_").isdecimal()
    }
    return found[max(found)] if found else None


@dataclass(frozen=True, slots=True)
class _Reading:
    """How a format is read."""

    check: Callable[[bytes, int, int], object]
    """Given the first bytes of a file, its size, and the most Gaussians: raises for a file that
    `decode` would refuse, as far as these show."""
    decode: Callable[[bytes, int], Splats]


_SPLAT = _Reading(lambda _, file_bytes, most: splat_count(file_bytes, most), decode_splat)
_KSPLAT = _Reading(ksplat_count, decode_ksplat)
_COMPRESSED_PLY = _Reading(compressed_layout, decode_compressed_ply)
_PLY = _Reading(ply_layout, decode_ply)
_SPZ = _Reading(spz_header, decode_spz)
_SOG = _Reading(lambda *_: None, decode_sog)


def _reading(head: bytes, suffix: str, beside: Beside = nothing_beside) -> _Reading:
    """How to read a file that begins with `head`. Raises a CodecError if that is unknown."""
    if suffix.lower() == SPLAT:
        return _SPLAT
    if suffix.lower() == KSPLAT and head:
        return _KSPLAT
    if head.startswith(b"ply"):
        return _COMPRESSED_PLY if is_compressed(read_ply_header(head)) else _PLY
    if head.startswith((b"NGSP", b"\x1f\x8b")):
        return _SPZ
    if head.startswith(ZIP_MAGIC):
        return _SOG
    if is_gltf(head):
        return _Reading(
            lambda start, file_bytes, _: check_glb(start, file_bytes),
            partial(decode_gltf, beside=beside),
        )
    if not head:
        raise CorruptError(f"is empty; this program reads {READ}")
    raise UnsupportedError(f"starts with {head[:4]!r}; this program reads {READ}")


def decode_any(data: bytes, suffix: str = "", max_gaussians: int = MAX_GAUSSIANS) -> Splats:
    """The Gaussians of a file that begins as a known format, or is called .splat or .ksplat, which
    have no magic.

    Raises CorruptError, or UnsupportedError, which is also for a file that claims more than
    `max_gaussians`: nothing of it is decoded.
    """
    return _reading(data, suffix).decode(data, max_gaussians)


def _beside(path: Path, name: str) -> bytes:
    """The file called `name` beside `path`."""
    return read_bounded(path.with_name(name), MAX_FILE_BYTES)


def read_splats(path: Path, max_gaussians: int = MAX_GAUSSIANS) -> Splats:
    """The Gaussians of the file at `path`, at most `max_gaussians`. It may also be the folder of an
    unbundled SOG, or the meta.json in one, or the folder of a training (`trained_ply`).

    Raises a CodecError that names the file. One that its size or its first bytes rule out is not
    read any further.
    """
    with reading(path):
        return _read(trained_ply(path) or path, max_gaussians)


def _read(path: Path, max_gaussians: int) -> Splats:
    if path.name == STREAMED_META or (path / STREAMED_META).is_file():
        raise UnsupportedError(
            f"{path}: a streamed SOG, whose levels of detail are not read; make one file of the "
            f"finest, for example by `splat-transform --select-lod 0 {STREAMED_META} model.sog`"
        )
    if path.name == META or is_sog_folder(path):
        folder = path.parent if path.name == META else path
        try:
            return decode_sog_folder(folder, max_gaussians)
        except CodecError as error:
            raise error.within(path) from error
    head, file_bytes = read_head(path, HEAD_BYTES)
    try:
        reading = _reading(head, path.suffix, partial(_beside, path))
        reading.check(head, file_bytes, max_gaussians)
    except CodecError as error:
        raise error.within(path) from error
    data = read_bounded(path, MAX_FILE_BYTES)
    try:
        return reading.decode(data, max_gaussians)
    except CodecError as error:
        raise error.within(path) from error


def encode_splats(
    splats: Splats, format: SplatFormat, spz_version: SpzVersion | None = None
) -> bytes:
    """The file of `splats`. Raises InvalidError, also for an `spz_version` of another format."""
    if spz_version is None:
        return ENCODERS[format](splats)
    if format is not SplatFormat.SPZ:
        raise InvalidError(f"a version of SPZ, but the format is {format}")
    return encode_spz(splats, spz_version)


def write_splats(
    path: Path, splats: Splats, format: SplatFormat, spz_version: SpzVersion | None = None
) -> int:
    """Puts `splats` at `path`, whole or not at all; gives the bytes written.

    Raises InvalidError for what the format cannot hold, and OSError.
    """
    data = encode_splats(splats, format, spz_version)
    write_atomic(path, data)
    return len(data)
