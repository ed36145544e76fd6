"""Every edit of all frames by one call: from places and options to the finished stream."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from codec.storage.openstorage import Place
from codec.stream.pictures import Draw
from codec.stream.reader import DEFAULT_MAX_GAUSSIANS

from .crop import Crop, CropOptions
from .floaters import FloaterOptions, Floaters
from .rewrite import Edited, Progress, no_progress, open_source, rewrite
from .transform import Transform, TransformOptions
from .view import View, ViewOptions
from .walk import Walk

Options = CropOptions | TransformOptions | FloaterOptions | ViewOptions
"""Options of an edit that `edit_stream` applies to every frame."""


def edit_stream(
    stream: Place,
    out: Path,
    options: Options,
    draw: Draw | None = None,
    progress: Progress = no_progress,
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
            crop = Crop(options)
            made = rewrite(reader, out, crop, draw, progress)
            return replace(made, notes=crop.notes)
        case ViewOptions():
            return rewrite(reader, out, View(options), draw, progress)
        case TransformOptions():
            transform = Transform(options, manifest)
            made = rewrite(reader, out, transform, draw, progress)
            return replace(made, notes=transform.notes)
    floaters, total = Floaters(options, manifest), 2 * reader.num_frames
    for frame in floaters.survey(Walk(reader)):
        progress(frame + 1, total)
    made = rewrite(reader, out, floaters, draw, lambda done, half: progress(half + done, total))
    return replace(made, notes=floaters.notes)
