"""Edits in time, with sound: `trim` keeps a part of the frames, `join` puts streams of the same
layout one after another.

Segments that lie whole in the part are copied.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from codec.errors import InvalidError
from codec.framerange import FrameRange
from codec.storage.openstorage import Place
from codec.stream.manifest import Manifest
from codec.stream.pictures import Draw
from codec.stream.reader import DEFAULT_MAX_GAUSSIANS, StreamReader

from .rewrite import (
    Edited,
    Progress,
    Recoder,
    add_tracks,
    copy_segment,
    no_progress,
    objects_bytes,
    open_source,
    writing,
)
from .segmentfiles import SegmentFiles
from .walk import Edit, SourceSlice, Walk


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


SAME = (
    "fps", "swin_size", "slots", "lattice", "segment_frames", "sh_degree", "antialias",
)  # fmt: skip
"""Fields of the manifest in which joined streams must agree."""


def join_streams(
    streams: Sequence[Place],
    out: Path,
    draw: Draw | None = None,
    progress: Progress = no_progress,
    max_gaussians: int | None = DEFAULT_MAX_GAUSSIANS,
) -> Edited:
    """Writes `streams` one after another as one at `out`, with the title, cameras and near plane of
    the first; see `edit_stream`.

    The segments of the first are copied, and those of the others where they fall on segments again,
    but for the one at each seam. There a lane changes when its turn comes: with a swin_size above 1
    the first swin_size - 1 frames after a seam show lanes of both streams. Raises a SwingsError.
    """
    if len(streams) < 2:
        raise InvalidError("only one stream to join; name another one")
    readers = [open_source(stream, max_gaussians) for stream in streams]
    total = sum(reader.num_frames for reader in readers)
    manifest = _manifest_of(readers)
    done = copied = renumbered = 0

    def show(num_done: int) -> None:
        progress(num_done, total)

    with writing(out, manifest, draw) as files:
        recoder = Recoder(files)
        for number, reader in enumerate(readers):
            is_last = number == len(readers) - 1
            num_whole = _append(reader, files, recoder, done, is_last, show)
            if done:
                renumbered += num_whole
            else:
                copied += num_whole
            done += reader.num_frames
        recoder.end_segment()
        notes = add_tracks(files, [(reader, range(reader.num_frames)) for reader in readers])
    source_bytes = sum(map(objects_bytes, readers))
    num_segments, size_bytes = files.num_segments, files.size_bytes
    return Edited(total, copied, renumbered, num_segments, size_bytes, source_bytes, notes)


def _append(
    reader: StreamReader,
    files: SegmentFiles,
    recoder: Recoder,
    offset: int,
    is_last: bool,
    progress: Callable[[int], None],
) -> int:
    """Appends the stream of `reader` from frame `offset` on; gives how many segments are
    copied."""
    length, num_frames = reader.manifest.segment_frames, reader.num_frames
    walk, copied, at = Walk(reader), 0, 0

    def recode(slices: Iterable[SourceSlice], joins: bool = False) -> None:
        for frame in recoder.append(walk, slices, Edit(), offset, joins):
            progress(offset + frame + 1)

    if offset:
        # Until every lane had its turn, and a segment is whole.
        at = num_frames
        if offset % length == 0:
            at = min(num_frames, -(-reader.manifest.swin_size // length) * length)
        recode(walk.replacing(range(at)), joins=True)
    end = num_frames if is_last or at == num_frames else num_frames // length * length
    for first in range(at, end, length):
        births = range(first, min(first + length, end))
        copy_segment(reader, first // length, births, offset, files)
        copied += 1
        progress(offset + births[-1] + 1)
    if is_last or end == num_frames == at:
        return copied
    if end > at:
        recoder.resume(walk.decoder(end - 1), offset)
    elif not offset:
        recode(walk.opening(0))
    recode(walk.slices(range(max(end, 1), num_frames)))
    return copied


def _manifest_of(readers: Sequence[StreamReader]) -> Manifest:
    """The manifest of the joined stream. Raises InvalidError for streams that do not fit."""
    first = readers[0].manifest
    for reader in readers[1:]:
        for name in SAME:
            mine, theirs = getattr(first, name), getattr(reader.manifest, name)
            if mine != theirs:
                raise InvalidError(
                    f"{reader.name} has another {name} than {readers[0].name}; only streams that "
                    f"agree in {', '.join(SAME)} can be joined"
                )
    lower = np.min([reader.manifest.bounds[0] for reader in readers], axis=0)
    upper = np.max([reader.manifest.bounds[1] for reader in readers], axis=0)
    (x, y, z), (u, v, w) = lower.tolist(), upper.tolist()
    return replace(first, bounds=((x, y, z), (u, v, w)))
