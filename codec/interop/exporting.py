"""Frames of a stream as files that other programs read."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path

from codec.errors import InvalidError
from codec.files import replacing
from codec.foreign.spz import SpzVersion
from codec.foreign.tsog import encode_tsog
from codec.framerange import FrameRange
from codec.outputlock import writing_alone
from codec.storage.openstorage import Place
from codec.stream.reader import DEFAULT_MAX_GAUSSIANS, StreamReader

from .formats import SplatFormat, write_splats

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
