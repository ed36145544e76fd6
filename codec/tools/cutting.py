"""Edits that change the segments, by one call: from places to the finished stream, with its
sound."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

from codec.edit.join import join_streams
from codec.edit.rewrite import AddSound, Edited, Progress, no_progress, open_source
from codec.edit.segmentfiles import SegmentFiles
from codec.edit.trim import trim
from codec.errors import InvalidError
from codec.framerange import FrameRange
from codec.storage.openstorage import Place
from codec.stream.pictures import Draw
from codec.stream.reader import DEFAULT_MAX_GAUSSIANS

from .streamsound import Cut, add_cuts


def trim_stream(
    stream: Place,
    out: Path,
    frames: FrameRange,
    draw: Draw | None = None,
    progress: Progress = no_progress,
    max_gaussians: int | None = DEFAULT_MAX_GAUSSIANS,
) -> Edited:
    """Writes `frames` of the stream at `stream` to `out`, with their sound; see `trim` and
    `edit_stream`."""
    reader = open_source(stream, max_gaussians)
    cut = reader, frames.of(reader.num_frames, reader.name)
    return _with_sound([cut], lambda sound: trim(reader, out, frames, draw, progress, sound))


def join(
    streams: Sequence[Place],
    out: Path,
    draw: Draw | None = None,
    progress: Progress = no_progress,
    max_gaussians: int | None = DEFAULT_MAX_GAUSSIANS,
) -> Edited:
    """Writes `streams` one after another to `out`, with their sound; see `join_streams` and
    `edit_stream`."""
    if len(streams) < 2:
        raise InvalidError("only one stream to join; name another one")
    readers = [open_source(stream, max_gaussians) for stream in streams]
    cuts = [(reader, range(reader.num_frames)) for reader in readers]
    return _with_sound(cuts, lambda sound: join_streams(readers, out, draw, progress, sound))


def _with_sound(cuts: Sequence[Cut], write: Callable[[AddSound], Edited]) -> Edited:
    """Calls `write` with a function that adds the sound of `cuts`; gives its result, with notes
    about sound and captions that are left out."""
    left_out: list[str] = []

    def add(files: SegmentFiles) -> None:
        left_out.extend(add_cuts(files, cuts))

    made = write(add)
    notes = list(made.notes)
    if left_out:
        notes.append(f"sound        left out: {', '.join(left_out)}; see swings-stream audio add")
    if any(reader.manifest.captions for reader, _ in cuts):
        notes.append("captions     left out; add them again with swings-stream captions add")
    return replace(made, notes=tuple(notes))
