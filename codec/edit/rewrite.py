"""A stream with an edit applied to every frame, from places and options to the finished stream.

Rule: what comes out as it was keeps its packet; only the frame numbers in it may change, of which
the first block of a packet is coded again. Segments that keep their place are copied whole.

An edit that rounds chooses its steps so that the stream does not grow: Gaussians along the axes
that are turned take more bits, and slightly larger steps save them. Where they do not, as for an
oblique turn of a model with few harmonics, the steps stay as they were, and the stream grows.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from codec.coders.blocks import Effort
from codec.coders.coder import EncodedChunk
from codec.errors import InvalidError
from codec.files import making_folder
from codec.slots.change import encoded_elsewhere
from codec.slots.decoder import SlotDecoder
from codec.slots.encoder import SlotEncoder
from codec.slots.slotlayout import Kind, with_birth
from codec.storage.openstorage import Place
from codec.stream.integrity import CheckedObject
from codec.stream.manifest import SKIP_MAPS, Manifest, Part, is_keyframe, keyframe_part
from codec.stream.pictures import Draw
from codec.stream.poster import POSTER_NAME, STORYBOARD_NAME, write_poster, write_storyboard
from codec.stream.reader import DEFAULT_MAX_GAUSSIANS, StreamReader
from codec.stream.segment import encode_packet, renumbered_packet
from codec.tracks.streamtracks import Cut, copy_tracks

from .filters import Crop, CropOptions, FloaterOptions, Floaters
from .segmentfiles import Scores, SegmentFiles
from .transform import Transform, TransformOptions
from .walk import Arrangement, Edit, SourceSlice, View, ViewOptions, Walk, derive


class Recoder:
    """Appends slices to `files`, and writes each segment that they complete."""

    def __init__(self, files: SegmentFiles) -> None:
        self._files = files
        self._encoder = SlotEncoder(files.manifest.slot_layout)
        self._arrangement = Arrangement()
        self._num_frames = 0
        """Frames in the segment that is not written yet."""
        self._same_as: Walk | None = None
        """Whose segment it is so far, packet for packet."""
        self.num_copied = 0
        """Segments written that a source has in the same place, byte for byte."""

    def resume(self, decoder: SlotDecoder, offset: int) -> None:
        """Goes on after what a reader of a source holds at the last frame of a segment, which is
        in `files` already. offset: added to births."""
        encoder = SlotEncoder.resumed(decoder)
        lanes = encoder.lanes
        encoder.lanes = [lanes[(n - offset) % len(lanes)] for n in range(len(lanes))]
        encoder.next_birth += offset
        self._encoder = encoder

    def append(
        self,
        walk: Walk,
        slices: Iterable[SourceSlice],
        edit: Edit,
        offset: int = 0,
        joins: bool = False,
    ) -> Iterator[int]:
        """Appends `slices` of `walk`, the one born at b as the one born at b + `offset`; gives each
        frame of the source once it is there. joins: whether they follow another stream, which
        the lanes hold until their first turn."""
        layout = self._encoder.layout
        for source in slices:
            birth = source.birth + offset
            held = self._encoder.lanes[layout.lane(birth)]
            turns = list(source.turns(walk.reader.manifest.slot_layout))
            if edit.rearranges:
                turns = [self._arrangement.arranged(turn, edit) for turn in turns]
            meets = joins and source.birth < layout.swin_size
            update = derive(birth, turns, held, edit, meets)
            encoded = self._encoder.append(update)
            if encoded is None:
                continue
            chunks: list[tuple[Part, EncodedChunk]] = [(SKIP_MAPS, encoded.skip_map)]
            chunks += enumerate(encoded.changes)
            if birth == layout.segment_start(birth):
                keyframes = enumerate(self._encoder.keyframes())
                chunks += [(keyframe_part(layer), chunk) for layer, chunk in keyframes]
                self._same_as = None if offset else walk
            for part, chunk in chunks:
                content, packet = (b"", b"") if offset else walk.content(birth, part)
                if content != chunk.data:
                    self._same_as, packet = None, self._packet(chunk)
                self._files.put(part, birth, packet)
            self._num_frames += 1
            if birth + 1 == layout.segment_start(birth + 1):
                self.end_segment()
            yield source.birth

    def end_segment(self) -> None:
        """Writes what is left as the last segment."""
        if not self._num_frames:
            return
        psnr_db = None
        if self._same_as is not None:
            reader = self._same_as.reader
            record = reader.records[self._files.num_frames // reader.manifest.segment_frames]
            if record.num_frames == self._num_frames:
                self.num_copied += 1
                psnr_db = record.psnr_db
        self._files.end_segment(self._num_frames, psnr_db)
        self._num_frames = 0

    def _packet(self, chunk: EncodedChunk) -> bytes:
        """`chunk` as a packet, the smallest of several: it shall not take more than the one that it
        replaces."""
        return encode_packet(chunk, Effort.MOST)


MOST = 2.0
"""Largest factor of the steps: 6 dB of the error that rounding makes."""

FIRST = 1.08
"""The factor that is tried after 1."""

LEAST = 1.01
"""Least factor from one try to the next."""

TRIES = 8


class Weighed(SegmentFiles):
    """Segments that are encoded only to measure their size; nothing is written."""

    weight_bytes = 0

    def add(self, objects: Mapping[Part, bytes], num_frames: int, psnr_db: Scores | None) -> None:
        self.weight_bytes += sum(map(len, objects.values()))


def fitted(reader: StreamReader, edit: Edit) -> Edit:
    """`edit`, with the smallest steps found with which the first segment of the stream of `reader`
    takes no more bytes than before; as it is if MOST is not enough. Raises a SwingsError."""
    if not edit.rounds:
        return edit
    limit_bytes, made, log_factor = sum(reader.records[0].part_bytes), edit, 0.0
    first_excess_bytes, most = 0, np.log(MOST)
    for tries in range(TRIES):
        excess_bytes = first_segment_bytes(reader, made) - limit_bytes
        if excess_bytes <= 0:
            return made
        if log_factor >= most:
            break
        step = np.log(FIRST)
        if not tries:
            first_excess_bytes = excess_bytes
        elif tries == TRIES - 2:
            step = most
        elif first_excess_bytes > excess_bytes:
            # Sizes fall about evenly, but not from one factor to a near one.
            step = log_factor * excess_bytes / (first_excess_bytes - excess_bytes)
        log_factor = min(log_factor + max(step, np.log(LEAST)), most)
        made = edit.coarser(float(np.exp(log_factor)))
    return edit


def first_segment_bytes(reader: StreamReader, edit: Edit) -> int:
    """Size of the objects of the first segment after `edit`."""
    files = Weighed(Path(), edit.manifest(reader.manifest))
    walk, recoder = Walk(reader), Recoder(files)
    for slices in (walk.opening(0), walk.slices(range(1, reader.records[0].num_frames))):
        for _ in recoder.append(walk, slices, edit):
            pass
    recoder.end_segment()
    return files.weight_bytes


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
        from codec.tracks.streamtracks import add_cuts  # PyAV loads slowly

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


def copy_segment(
    reader: StreamReader, segment: int, births: range, offset: int, files: SegmentFiles
) -> bool:
    """Writes the slices of `births`, some of those of `segment`, as the next segment of `files`;
    gives whether it is the same byte for byte.

    offset: added to births; a whole number of segments. What comes from the slice that becomes
    frame 0 is in the keyframes.
    """
    record, manifest = reader.records[segment], reader.manifest
    whole = len(births) == record.num_frames
    objects = {part: reader.read_object(segment, part) for part in manifest.parts}
    psnr_db: Scores | None = record.psnr_db if whole else None
    if whole and not offset:
        files.add({part: found.data for part, found in objects.items()}, len(births), psnr_db)
        return True
    for part, found in objects.items():
        for entry in found.entries:
            birth = entry.birth + offset
            if entry.birth in births and (birth or is_keyframe(part)):
                files.put(part, birth, renumbered(found, entry.birth, offset))
    files.end_segment(len(births), psnr_db)
    return False


def renumbered(found: CheckedObject, birth: int, offset: int) -> bytes:
    """The packet of `birth` in `found` as that of `birth` + `offset`."""
    packet = found.packet(birth)
    if not offset:
        return packet
    return renumbered_packet(packet, _chunk_elsewhere(found, birth, offset))


def _chunk_elsewhere(found: CheckedObject, birth: int, offset: int) -> EncodedChunk:
    """The chunk of `birth` in `found`, to be compressed once more as that of `birth` + `offset`."""
    layout, part, data = found.manifest.slot_layout, found.part, found.content(birth)
    kind = Kind.CHANGE if isinstance(part, int) else Kind.KEYFRAME
    if part == SKIP_MAPS:
        kind = Kind.SKIP_MAP
    return encoded_elsewhere(layout, kind, with_birth(data, birth + offset))
