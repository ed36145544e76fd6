"""Trim: a part of the frames, with its sound. Segments that lie whole in it are copied."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from codec.framerange import FrameRange
from codec.storage.openstorage import Place
from codec.stream.pictures import Draw
from codec.stream.reader import DEFAULT_MAX_GAUSSIANS

from .copying import copy_segment
from .edit import Edit
from .recoder import Recoder
from .rewrite import (
    Edited,
    Progress,
    add_tracks,
    no_progress,
    objects_bytes,
    open_source,
    writing,
)
from .walk import Walk


def trim_stream(
    stream: Place,
    out: Path,
    frames: FrameRange,
    draw: Draw | None = None,
    progress: Progress = no_progress,
    max_gaussians: int | None = DEFAULT_MAX_GAUSSIANS,
) -> Edited:
    """Writes the `frames` of the stream at `stream` as a stream of their own at `out`, see
    `edit_stream`.

    If the first one begins a segment, all is copied; else the slices are put into other segments,
    with the same numbers for every Gaussian. Raises a SwingsError that names the file at fault.
    """
    reader = open_source(stream, max_gaussians)
    wanted = frames.of(reader.num_frames, reader.name)
    manifest = reader.manifest
    manifest = replace(manifest, capture_frame=manifest.capture_frame + wanted[0])
    length, copied, renumbered = manifest.segment_frames, 0, 0
    with writing(out, manifest, draw) as files:
        if wanted[0] % length == 0:
            for first in wanted[::length]:
                births = range(first, min(first + length, wanted[-1] + 1))
                is_same = copy_segment(reader, first // length, births, -wanted[0], files)
                copied, renumbered = copied + is_same, renumbered + (not is_same)
                progress(births[-1] + 1 - wanted[0], len(wanted))
        else:
            walk, recoder = Walk(reader), Recoder(files)
            for slices in (walk.opening(wanted[0]), walk.slices(wanted[1:])):
                for frame in recoder.append(walk, slices, Edit(), -wanted[0]):
                    progress(frame + 1 - wanted[0], len(wanted))
            recoder.end_segment()
        notes = add_tracks(files, [(reader, wanted)])
    return Edited(
        len(wanted),
        copied,
        renumbered,
        files.num_segments,
        files.size_bytes,
        objects_bytes(reader),
        notes,
    )
