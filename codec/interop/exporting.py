"""Frames of a stream as files that other programs read."""

from __future__ import annotations

from pathlib import Path

from codec.errors import InvalidError
from codec.foreign.spz import SpzVersion
from codec.framerange import FrameRange
from codec.storage.openstorage import Place
from codec.stream.reader import DEFAULT_MAX_GAUSSIANS, StreamReader

from .formats import SplatFormat, write_splats

NUMBER_DIGITS = 4
"""Fewest digits of a frame number in a file name: `name_0000.ply`."""


def chosen_format(out: Path, format: SplatFormat | None) -> SplatFormat:
    """`format`, or the one that the name of `out` ends with. Raises InvalidError for neither."""
    if format is not None:
        return format
    try:
        return SplatFormat(out.suffix.lower().removeprefix("."))
    except ValueError as error:
        names = ", ".join(SplatFormat)
        raise InvalidError(f"{out}: give --format, one of {names}") from error


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
    format: SplatFormat | None,
    layers: int | None,
    spz_version: SpzVersion | None = None,
    max_gaussians: int | None = DEFAULT_MAX_GAUSSIANS,
) -> list[Path]:
    """Writes what shows at `frame` to `out`, or each of `frames` to `out`_NNNN.

    `layers` counts from the most important one; all by default. Existing files are replaced.
    max_gaussians: see `check_gaussians`. Raises a SwingsError; the files written before it stay.
    """
    if (frame is None) == (frames is None):
        raise InvalidError("give either --frame F or --frames A:B")
    format = chosen_format(out, format)
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
