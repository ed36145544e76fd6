"""A stream with an edit applied to every frame, and what all edits have in common."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path

from codec.errors import InvalidError
from codec.files import making_folder
from codec.storage.openstorage import Place
from codec.stream.manifest import Manifest
from codec.stream.pictures import Draw
from codec.stream.poster import POSTER_NAME, write_poster
from codec.stream.reader import DEFAULT_MAX_GAUSSIANS, StreamReader
from codec.stream.storyboard import STORYBOARD_NAME, write_storyboard
from codec.tracks.streamtracks import Cut, copy_tracks

from .edit import Edit
from .fitting import fitted
from .recoder import Recoder
from .segmentfiles import SegmentFiles
from .walk import Walk

Progress = Callable[[int, int], None]
"""Called after each frame with the number of frames done and their total."""


def no_progress(done: int, total: int) -> None:
    """Reports no progress."""


@dataclass(frozen=True, slots=True)
class Edited:
    """The result of an edit, in figures."""

    num_frames: int
    num_copied: int
    """Segments whose objects are those of a source, byte for byte."""
    num_renumbered: int
    """Segments whose chunks are those of a source but for the frame numbers in them."""
    num_segments: int
    size_bytes: int
    """Size of all objects."""
    source_bytes: int
    """The same of the sources."""
    notes: tuple[str, ...] = ()
    """More lines for the user."""


def open_source(stream: Place, max_gaussians: int | None = DEFAULT_MAX_GAUSSIANS) -> StreamReader:
    """A reader of `stream`. Raises InvalidError if it has no frames."""
    reader = StreamReader(stream, max_gaussians)
    if not reader.records:
        raise InvalidError(f"{reader.name} has no frames yet; there is nothing to edit")
    return reader


def objects_bytes(reader: StreamReader) -> int:
    """Size of all objects."""
    return sum(sum(record.part_bytes) for record in reader.records)


@contextmanager
def writing(
    out: Path,
    manifest: Manifest,
    draw: Draw | None,
    tracks: StreamReader | None = None,
) -> Iterator[SegmentFiles]:
    """Gives what the segments of a new stream at `out`, absent or an empty folder, are put into.

    It appears there, finished, when the block is left normally, and with a poster and a storyboard
    if there is something to draw them with; else nothing does. tracks: the stream whose sound and
    captions go along, segment by segment; without it the new one has none but what `add_tracks`
    puts there.
    """
    pictures = (None, None) if draw is None else (POSTER_NAME, STORYBOARD_NAME)
    manifest = replace(manifest, poster=pictures[0], storyboard=pictures[1])
    manifest = manifest if tracks is not None else replace(manifest, sound=(), captions=())
    with making_folder(out) as folder:
        files = SegmentFiles(folder, manifest)
        yield files
        if tracks is not None:
            copy_tracks(tracks, folder)
        files.finish()
        if draw is not None:
            write_poster(folder, draw)
            write_storyboard(folder, draw)


def add_tracks(files: SegmentFiles, cuts: Sequence[Cut]) -> tuple[str, ...]:
    """Adds the sound of `cuts`, joined in this order, to a stream whose segments are all written;
    gives notes about sound and captions that are left out. Raises a SwingsError."""
    notes, left_out = [], list[str]()
    if any(reader.manifest.sound for reader, _ in cuts):
        from codec.tracks.streamsound import add_cuts  # PyAV loads slowly

        files.manifest, left_out = add_cuts(files.folder, files.manifest, files.records, cuts)
    if left_out:
        notes.append(f"sound        left out: {', '.join(left_out)}; see swings-stream audio add")
    if any(reader.manifest.captions for reader, _ in cuts):
        notes.append("captions     left out; add them again with swings-stream captions add")
    return tuple(notes)


def rewrite(
    reader: StreamReader,
    out: Path,
    edit: Edit,
    draw: Draw | None,
    progress: Progress,
) -> Edited:
    """Writes the stream of `reader`, as far as it has come, with `edit` to `out`; see `writing`.
    Raises a SwingsError that names the file at fault.
    """
    num_frames, edit = reader.num_frames, fitted(reader, edit)
    with writing(out, edit.manifest(reader.manifest), draw, reader) as files:
        walk, recoder = Walk(reader), Recoder(files)
        for slices in (walk.opening(0), walk.slices(range(1, num_frames))):
            for birth in recoder.append(walk, slices, edit):
                progress(birth + 1, num_frames)
        recoder.end_segment()
        edit.check()
    return Edited(
        num_frames,
        recoder.num_copied,
        0,
        len(reader.records),
        files.size_bytes,
        objects_bytes(reader),
    )
