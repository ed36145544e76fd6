"""The formats of Gaussians that are read and written, by the name and the first bytes of a file:
single frames, whole sequences, and the frames of a stream.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from enum import StrEnum
from functools import partial
from pathlib import Path

from codec.errors import CodecError, CorruptError, InvalidError, UnsupportedError
from codec.files import read_bounded, read_head, replacing, write_atomic
from codec.foreign.bounds import MAX_GAUSSIANS
from codec.foreign.gltf import (
    Beside,
    check_glb,
    decode_gltf,
    encode_glb,
    encode_gltf,
    is_gltf,
    nothing_beside,
)
from codec.foreign.ksplat import decode_ksplat, ksplat_count
from codec.foreign.notes import reading
from codec.foreign.ply import (
    MAX_HEADER_BYTES,
    compressed_layout,
    decode_compressed_ply,
    decode_ply,
    encode_ply,
    is_compressed,
    ply_layout,
    read_ply_header,
)
from codec.foreign.sog import MAGIC as ZIP_MAGIC
from codec.foreign.sog import META, decode_sog, decode_sog_folder, encode_sog, is_sog_folder
from codec.foreign.splat import decode_splat, encode_splat, splat_count
from codec.foreign.spz import SpzVersion, decode_spz, encode_spz, spz_header
from codec.foreign.tsog import TsogReader, encode_tsog
from codec.framerange import FrameRange
from codec.outputlock import writing_alone
from codec.splats import Splats
from codec.storage.openstorage import Place
from codec.stream.reader import DEFAULT_MAX_GAUSSIANS, StreamReader

TSOG_SUFFIX = ".tsog"
"""The name of a file that begins like any ZIP archive."""


@dataclass(frozen=True, slots=True)
class ContainedFrame:
    """A frame of the container at `path`."""

    path: Path
    number: int
    reader: TsogReader

    def __str__(self) -> str:
        return f"{self.path} frame {self.number}"

    @property
    def name(self) -> str:
        """As `Path.name`: of the file alone, and which frame."""
        return f"{self.path.name} frame {self.number}"

    def read(self, max_gaussians: int) -> Splats:
        """Its Gaussians. Raises a CodecError that names it."""
        try:
            with reading(self):
                return self.reader.read(self.number, max_gaussians)
        except CodecError as error:
            raise error.within(self) from error


def contained_frames(path: Path) -> list[ContainedFrame] | None:
    """The frames of the file at `path`; None if it is no container of a sequence. Raises a
    CodecError that names the file."""
    if path.suffix.lower() != TSOG_SUFFIX or not path.is_file():
        return None
    if read_head(path, len(ZIP_MAGIC))[0] != ZIP_MAGIC:
        return None
    try:
        with reading(path):
            reader = TsogReader(path)
    except CodecError as error:
        raise error.within(path) from error
    return [ContainedFrame(path, number, reader) for number in range(reader.num_frames)]


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


NUMBER_DIGITS = 4
"""Fewest digits of a frame number in a file name: `name_0000.ply`."""


class SequenceFormat(StrEnum):
    """The formats of sequences that can be written."""

    TSOG = "tsog"


def chosen_format(
    out: Path, format: SplatFormat | SequenceFormat | None
) -> SplatFormat | SequenceFormat:
    """`format`, or the one that the name of `out` ends with. Raises InvalidError for neither."""
    if format is not None:
        return format
    suffix = out.suffix.lower().removeprefix(".")
    if suffix in set(SequenceFormat):
        return SequenceFormat(suffix)
    try:
        return SplatFormat(suffix)
    except ValueError as error:
        names = ", ".join([*SplatFormat, *SequenceFormat])
        raise InvalidError(
            f"{out}: the name ends with no known suffix; give --format, one of {names}"
        ) from error


def numbered(out: Path, frame: int, format: SplatFormat) -> Path:
    """The file of `frame` in the sequence that `out` names, with or without its suffix.

    Raises InvalidError for an `out` that does not end in a name, such as `.` or `/`.
    """
    if not out.name:
        raise InvalidError(f"{out} names no file to number; give it a name, such as frame.{format}")
    stem = out.stem if out.suffix.lower() == f".{format}" else out.name
    return out.with_name(f"{stem}_{frame:0{NUMBER_DIGITS}}.{format}")


def export_stream(
    stream: Place,
    out: Path,
    frame: int | None,
    frames: str | None,
    format: SplatFormat | SequenceFormat | None,
    layers: int | None,
    spz_version: SpzVersion | None = None,
    max_gaussians: int | None = DEFAULT_MAX_GAUSSIANS,
) -> list[Path]:
    """Writes what shows at `frame` to `out`, or each of `frames` to `out`_NNNN; or, in a
    SequenceFormat, all of `frames` to `out`.

    `layers` counts from the most important one; all by default, as are `frames` of a sequence.
    Existing files are replaced. max_gaussians: see `check_gaussians`. Raises a SwingsError; the
    files written before it stay.
    """
    format = chosen_format(out, format)
    if isinstance(format, SequenceFormat):
        if frame is not None or spz_version is not None:
            raise InvalidError(f"{format} holds a sequence; choose its frames by --frames A:B")
        reader = StreamReader(stream, max_gaussians)
        _export_sequence(reader, out, frames, layers)
        return [out]
    if (frame is None) == (frames is None):
        raise InvalidError("give either --frame F or --frames A:B")
    if spz_version is not None and format is not SplatFormat.SPZ:
        raise InvalidError(f"--spz-version is for spz; the files would be {format}")
    reader = StreamReader(stream, max_gaussians)
    layers = reader.manifest.num_layers if layers is None else layers
    if frames is not None:
        wanted = FrameRange.parse(frames).of(reader.num_frames, reader.name)
    elif frame is not None and 0 <= frame < reader.num_frames:
        wanted = range(frame, frame + 1)
    else:
        raise InvalidError(f"{reader.name} has no frame {frame}; it has {reader.num_frames} frames")
    written = []
    with writing_alone(out):
        for number in wanted:
            path = out if frames is None else numbered(out, number, format)
            splats = reader.active_splats(number, layers)
            try:
                path.parent.mkdir(parents=True, exist_ok=True)
                write_splats(path, splats, format, spz_version)
            except OSError as error:
                raise InvalidError(f"{path} cannot be written: {error.strerror}") from error
            written.append(path)
    return written


def _export_sequence(
    reader: StreamReader, out: Path, frames: str | None, layers: int | None
) -> None:
    """Writes `frames` to the file `out`, whole or not at all."""
    wanted = FrameRange.parse(frames or "0:").of(reader.num_frames, reader.name)
    layers = reader.manifest.num_layers if layers is None else layers
    try:
        out.parent.mkdir(parents=True, exist_ok=True)
        with writing_alone(out), replacing(out) as temporary:
            shown = [reader.active_splats(frame, layers) for frame in wanted]
            temporary.write_bytes(encode_tsog(shown, reader.manifest.fps))
    except OSError as error:
        raise InvalidError(f"{out} cannot be written: {error.strerror}") from error
