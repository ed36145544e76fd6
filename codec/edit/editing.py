"""Every kind of edit by one call: from places and options to the finished stream."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from codec.errors import InvalidError
from codec.framerange import FrameRange
from codec.storage.openstorage import Place
from codec.stream.pictures import Draw
from codec.stream.reader import DEFAULT_MAX_GAUSSIANS

from .crop import Crop, CropOptions
from .floaters import FloaterOptions, Floaters
from .join import join_streams
from .recolour import Colour, ColourOptions
from .rewrite import Edited, Progress, open_source, rewrite
from .transform import Transform, TransformOptions
from .trim import trim
from .walk import Walk

Options = CropOptions | TransformOptions | ColourOptions | FloaterOptions
"""Options of an edit that `edit_stream` applies to every frame."""


def _nothing(done: int, total: int) -> None:
    pass


def edit_stream(
    stream: Place,
    out: Path,
    options: Options,
    draw: Draw | None = None,
    progress: Progress = _nothing,
    max_gaussians: int | None = DEFAULT_MAX_GAUSSIANS,
) -> Edited:
    """Writes the stream at `stream`, as far as it has come, edited and finished to `out`, absent or
    an empty folder, which appears whole or not at all.

    draw: for a new poster and storyboard; without it there are none. max_gaussians: see
    `check_gaussians`. Memory is bounded by a segment and what the slots hold. Raises a SwingsError
    that names the file at fault.
    """
    reader = open_source(stream, max_gaussians)
    manifest = reader.manifest
    match options:
        case CropOptions():
            return rewrite(reader, out, Crop(options), draw, progress)
        case ColourOptions():
            return rewrite(reader, out, Colour(options, manifest), draw, progress)
        case TransformOptions():
            transform = Transform(options, manifest)
            made = rewrite(reader, out, transform, draw, progress)
            return replace(made, notes=transform.notes)
    floaters, total = Floaters(options, manifest), 2 * reader.num_frames
    for frame in floaters.survey(Walk(reader)):
        progress(frame + 1, total)
    made = rewrite(reader, out, floaters, draw, lambda done, half: progress(half + done, total))
    return replace(made, notes=floaters.notes)


def trim_stream(
    stream: Place,
    out: Path,
    frames: FrameRange,
    draw: Draw | None = None,
    progress: Progress = _nothing,
    max_gaussians: int | None = DEFAULT_MAX_GAUSSIANS,
) -> Edited:
    """Writes `frames` of the stream at `stream` to `out`; see `trim` and `edit_stream`."""
    return trim(open_source(stream, max_gaussians), out, frames, draw, progress)


def join(
    streams: Sequence[Place],
    out: Path,
    draw: Draw | None = None,
    progress: Progress = _nothing,
    max_gaussians: int | None = DEFAULT_MAX_GAUSSIANS,
) -> Edited:
    """Writes `streams` one after another to `out`; see `join_streams` and `edit_stream`."""
    if len(streams) < 2:
        raise InvalidError("only one stream to join; name another one")
    readers = [open_source(stream, max_gaussians) for stream in streams]
    return join_streams(readers, out, draw, progress)
