"""Writes a stream to a folder or an object store: a reader always sees a valid, shorter stream. A
caller's `quality` scores each frame; the index holds the mean over a segment.

Rule: an object is whole and in its place before the index record that names it is appended (see
codec/storage/folder and growingstore). Killing the writer at any instant loses at most the segment
being written. That segment is a draft, which never changes: taking in a slice gives another one, so
whatever fails on the way leaves the writer as it was.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from types import TracebackType

from codec.coders.blocks import Effort
from codec.coders.coder import EncodedChunk
from codec.errors import InvalidError
from codec.slice import Slice, window_births
from codec.slots.decoder import SlotDecoder
from codec.slots.encoder import SlotEncoder
from codec.slots.slotlayout import Update
from codec.storage.openstorage import Target, open_growing
from codec.storage.storage import GrowingPiece, GrowingPlace, Shape

from .manifest import MANIFEST_NAME, SEGMENTS_NAME, SKIP_MAPS, Manifest, Part, keyframe_part
from .reader import StreamReader
from .segment import (
    INDEX_NAME,
    SegmentRecord,
    encode_packet,
    join_packets,
    pack_record,
    packet_content,
    record_bytes,
)
from .wholeslice import RANKS, Rank, whole_update

Quality = Callable[[int, Sequence[Slice]], Sequence[float] | None]
"""Takes a birth and, for 1, 2, ... layers, the whole decoded slice. Gives the PSNR in dB of the
frame that the slice is born in, with 1, 2, ... layers; None for a slice born before frame 0."""

Whole = Callable[[Slice], Update]
"""Makes of a slice the update that sends it whole. Raises InvalidError."""

Packets = tuple[tuple[int, bytes], ...]
"""(birth, packet) of one part of a segment, in order of birth."""

Scores = tuple[tuple[float, ...], ...]
"""PSNR in dB of each frame with 1, 2, ... layers."""


def _measured(
    quality: Quality | None, birth: int, slices: Sequence[Slice]
) -> tuple[tuple[float, ...], ...]:
    """The scores of a slice, if it has any; slices: for 1, 2, ... layers."""
    if quality is None:
        return ()
    scores_db = quality(birth, slices)
    if scores_db is None:
        return ()
    if len(scores_db) != len(slices) or any(map(math.isinf, scores_db)):
        raise InvalidError(
            f"a quality of {tuple(scores_db)} dB is not {len(slices)} numbers, each finite, or NaN "
            "where unknown"
        )
    return (tuple(scores_db),)


@dataclass(frozen=True, slots=True)
class Draft:
    """A writer's state between two segments."""

    manifest: Manifest
    quality: Quality | None
    encoder: SlotEncoder
    """Never altered, like the decoder; what follows is a copy that went on."""
    decoder: SlotDecoder | None
    """The state of a reader that has read everything so far; only to measure quality, and from
    frame 0 on."""
    packets: dict[Part, Packets]
    whole: Whole
    """Makes an update of a slice that is sent whole."""
    scores_db: Scores = ()
    effort: Effort = Effort.USUAL
    """Spent on making packets small."""

    @staticmethod
    def first(
        manifest: Manifest,
        whole: Whole,
        quality: Quality | None,
        read: SlotDecoder | None = None,
        effort: Effort = Effort.USUAL,
    ) -> Draft:
        """The draft of the first segment, or of the one after what `read` has read."""
        encoder = SlotEncoder(manifest.slot_layout) if read is None else SlotEncoder.resumed(read)
        packets: dict[Part, Packets] = dict.fromkeys(manifest.parts, ())
        decoder = read if quality else None
        return Draft(manifest, quality, encoder, decoder, packets, whole, (), effort)

    @staticmethod
    def opened(
        manifest: Manifest, whole: Whole, quality: Quality | None, opening: Sequence[Update]
    ) -> Draft:
        """The draft of the segment after the updates `opening`, see `SlotEncoder.opened`."""
        encoder = SlotEncoder.opened(manifest.slot_layout, opening)
        packets: dict[Part, Packets] = dict.fromkeys(manifest.parts, ())
        return Draft(manifest, quality, encoder, None, packets, whole)

    @property
    def num_packets(self) -> int:
        """Packets that wait for the segment to be whole."""
        return sum(map(len, self.packets.values()))

    def after(self, slice: Slice | Update) -> Draft:
        """The draft that has `slice`, too, which is the next one. Raises InvalidError."""
        update = slice if isinstance(slice, Update) else self.whole(slice)
        encoder = self.encoder.copy()
        encoded = encoder.append(update)
        if encoded is None:
            return replace(self, encoder=encoder)
        birth, packets = update.birth, dict(self.packets)
        parts: list[tuple[Part, EncodedChunk]] = [
            (SKIP_MAPS, encoded.skip_map),
            *enumerate(encoded.changes),
        ]
        if birth % self.manifest.segment_frames == 0:
            keyframes = enumerate(encoder.keyframes())
            parts += [(keyframe_part(layer), chunk) for layer, chunk in keyframes]
        for part, chunk in parts:
            packets[part] = (*packets[part], (birth, encode_packet(chunk, effort=self.effort)))
        after = replace(self, encoder=encoder, packets=packets)
        return after if self.quality is None else after._scored(birth)

    def _scored(self, birth: int) -> Draft:
        """The draft with the scores of the slice of `birth`, its last one: of the bytes as they
        are, not of what was given."""
        manifest, layers = self.manifest, range(1, self.manifest.num_layers + 1)
        births = range(birth, birth + 1)
        if self.decoder is None:
            decoder = SlotDecoder(manifest.slot_layout)
            for layer in range(manifest.num_layers):
                decoder.load(self._content(keyframe_part(layer)), layer, birth)
            births = window_births(birth, manifest.swin_size)
        else:
            decoder = self.decoder.copy()
            changes = [self._content(layer) for layer in range(manifest.num_layers)]
            decoder.apply(birth, self._content(SKIP_MAPS), changes)
        scores_db = self.scores_db
        for number in births:
            slices = [decoder.whole(number, n) for n in layers]
            scores_db += _measured(self.quality, number, slices)
        return replace(self, decoder=decoder, scores_db=scores_db)

    @property
    def slice_bytes(self) -> int:
        """Size of the last slice's packets, without keyframes."""
        parts = (SKIP_MAPS, *range(self.manifest.num_layers))
        return sum(len(packet) for part in parts for _, packet in self.packets[part][-1:])

    def _content(self, part: Part) -> bytes:
        """The chunk in the last packet of `part`."""
        return packet_content(self.packets[part][-1][1], self.manifest.max_content_bytes(part))

    def objects(self) -> dict[Part, bytes]:
        """The objects of the segment."""
        return {part: join_packets(packets) for part, packets in self.packets.items()}

    def emptied(self) -> Draft:
        """The draft of the segment that follows."""
        packets: dict[Part, Packets] = dict.fromkeys(self.packets, ())
        return replace(self, packets=packets, scores_db=())


SHAPE = Shape(log=INDEX_NAME, head=MANIFEST_NAME, folder=SEGMENTS_NAME)

SegmentSound = Callable[[int, int], Mapping[str, bytes]]
"""Gives the objects of sound of a segment, by their names; from its first frame to its end."""


class StreamWriter:
    """Appends slices to a stream; holds the compressed chunks of one segment at most, and what the
    slots hold.

    Use it with `with`: leaving normally closes the stream, leaving by an exception aborts it, which
    keeps the finished segments and leaves the stream live for `resume`.
    """

    def __init__(
        self,
        target: Target,
        place: GrowingPlace | GrowingPiece,
        manifest: Manifest,
        records: list[SegmentRecord],
        rank: Rank,
        quality: Quality | None,
        read: SlotDecoder | None = None,
        exact: bool = False,
        effort: Effort = Effort.USUAL,
    ) -> None:
        """Use `create` or `resume`. read: what a reader has at the end of `records`."""
        if rank not in RANKS:  # callers without a type checker pass any string
            raise InvalidError(f"no rank is called {rank!r}; there are {', '.join(RANKS)}")
        self.target = target
        self._place = place
        self.manifest = manifest
        self._num_segments = len(records)
        self._whole = partial(
            whole_update, layout=manifest.slot_layout, rank=RANKS[rank], exact=exact
        )
        self._draft = Draft.first(manifest, self._whole, quality, read, effort)
        self._closed = False
        self.sound: SegmentSound | None = None
        """Gives the objects of the manifest's sources; set it before `append` if there are any."""
        self.next_birth = (
            records[-1].first_frame + records[-1].num_frames if records else manifest.first_birth
        )
        """Birth of the slice that `append` wants next."""
        self.bytes_written = sum(sum(record.part_bytes) for record in records)
        """Bytes of the finished segments' objects."""
        self.played_bytes = sum(record.played_bytes for record in records)
        """Bytes of those that a player from frame 0 on fetches."""
        self.slice_bytes = 0
        """Bytes of the last slice's packets, without keyframes."""

    @classmethod
    def create(
        cls,
        target: Target,
        manifest: Manifest,
        rank: Rank = Rank.OPACITY,
        quality: Quality | None = None,
        exact: bool = False,
        in_use: bool = False,
        effort: Effort = Effort.USUAL,
    ) -> StreamWriter:
        """A writer of a new stream at `target`, which is absent, empty, or a place where a
        writer was killed before it was a stream.

        `rank` orders the Gaussians of each Slice into layers; `exact` keeps every float32 of it.
        `quality` scores every frame; the index holds its mean over each segment, or NaN without it.
        in_use: the caller has checked the place, and keeps files of its own there. effort: spent
        on making packets small.
        """
        place = open_growing(target, SHAPE)
        live = manifest.with_live(True)
        writer = cls(target, place, live, [], rank, quality, None, exact, effort)
        place.begin(writer.manifest.to_json(), others_began=in_use)
        return writer

    @classmethod
    def resume(
        cls,
        target: Target,
        rank: Rank = Rank.OPACITY,
        quality: Quality | None = None,
        exact: bool = False,
        effort: Effort = Effort.USUAL,
    ) -> StreamWriter:
        """A writer that goes on after `target`'s last finished segment; `next_birth` says where."""
        reader = StreamReader(target, max_gaussians=None)
        manifest, records = reader.manifest, reader.records
        if not manifest.live:
            raise InvalidError(f"{target} is finished; write to another folder")
        place = open_growing(target, SHAPE)
        record_size = record_bytes(manifest.num_layers)
        place.take_over(reader.index_bytes, record_size, len(records))
        read, slice_bytes = None, 0
        if records:
            last = reader.num_frames - 1
            read = reader.decoder_at(last, manifest.num_layers)
            parts = (SKIP_MAPS, *range(manifest.num_layers))
            objects = [reader.read_object(len(records) - 1, part) for part in parts]
            slice_bytes = sum(len(object.packet(last)) for object in objects)
        writer = cls(target, place, manifest, records, rank, quality, read, exact, effort)
        writer.slice_bytes = slice_bytes
        return writer

    @classmethod
    def piece(
        cls,
        place: GrowingPlace | GrowingPiece,
        manifest: Manifest,
        segment: int,
        opening: Sequence[Update],
        quality: Quality | None = None,
    ) -> StreamWriter:
        """A writer of the segments from `segment` on, of a stream that is put together of
        pieces.

        opening: what shows in the frame before, see `SlotEncoder.opened`; none before segment 0.
        """
        writer = cls(place.name, place, manifest.with_live(True), [], Rank.OPACITY, quality)
        if segment:
            writer._num_segments = segment
            writer.next_birth = segment * manifest.segment_frames
            if not opening or opening[-1].birth + 1 != writer.next_birth:
                raise InvalidError(f"{place.name}: segment {segment} needs the slices before it")
            writer._draft = Draft.opened(manifest, writer._whole, quality, opening)
        return writer

    @property
    def complete(self) -> bool:
        """Whether a short last segment stands already, after which nothing can be appended."""
        return self._num_segments * self.manifest.segment_frames > max(self.next_birth, 0)

    @property
    def durable_birth(self) -> int:
        """Births below this one lie in finished segments; the others are lost by a kill."""
        if not self._num_segments:
            return self.manifest.first_birth
        return min(self.next_birth, self._num_segments * self.manifest.segment_frames)

    @property
    def num_packets(self) -> int:
        """Packets that wait for their segment to be whole."""
        return self._draft.num_packets

    def append(self, slice: Slice | Update) -> None:
        """Takes the slice born at `next_birth`; writes the segment that it completes. A Slice is
        sent whole, an Update as what changes.

        If it raises, nothing of the slice is kept: the same one, or another, may be tried again.
        """
        if self._closed:
            raise InvalidError(f"{self._place.name}: the writer is closed")
        if slice.birth != self.next_birth:
            raise InvalidError(
                f"{self._place.name}: slice born at {slice.birth}, expected {self.next_birth}"
            )
        if self.complete:
            raise InvalidError(
                f"{self._place.name}: the last segment is short; nothing can follow it"
            )
        try:
            draft = self._draft.after(slice)
        except InvalidError as error:
            raise InvalidError(f"{self._place.name}: {error}") from error
        self.slice_bytes = draft.slice_bytes
        next_birth = slice.birth + 1
        if next_birth == (self._num_segments + 1) * self.manifest.segment_frames:
            self._write_segment(draft, next_birth)
        else:
            self._draft, self.next_birth = draft, next_birth

    def _write_segment(self, draft: Draft, next_birth: int) -> None:
        """Writes the segment of `draft`; only then takes note of it, so that it may fail."""
        segment = self._num_segments
        first_frame = segment * self.manifest.segment_frames
        objects = draft.objects()
        files = {str(part): data for part, data in objects.items()}
        if self.sound is not None:
            files.update(self.sound(first_frame, next_birth))
        self._place.add(segment, files)
        data_of_parts = [objects[part] for part in self.manifest.parts]
        num_frames, psnr_db = next_birth - first_frame, _mean(draft.scores_db)
        record = SegmentRecord.of(data_of_parts, segment, first_frame, num_frames, psnr_db)
        index_bytes = segment * record_bytes(self.manifest.num_layers)
        self._place.append(index_bytes, pack_record(record))
        self._num_segments += 1
        self.next_birth = next_birth
        self.bytes_written += sum(record.part_bytes)
        self.played_bytes += record.played_bytes
        self._draft = draft.emptied()

    def close(self) -> None:
        """Writes the short last segment, if there is one, and marks the stream as finished."""
        if self._closed:
            return
        if self.num_packets and self.next_birth > 0:
            self._write_segment(self._draft, self.next_birth)
        finished = self.manifest.with_live(False)
        self._place.finish(finished.to_json())
        self.manifest = finished
        self._closed = True  # only now: what failed above may be tried again

    def abort(self) -> None:
        """Drops the unfinished segment and leaves the stream live."""
        self._closed = True
        self._draft = self._draft.emptied()

    def __enter__(self) -> StreamWriter:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        if kind is None:
            self.close()
        else:
            self.abort()


def _mean(scores_db: Scores) -> tuple[float, ...] | None:
    """The mean over the frames, for each number of layers; None without any."""
    if not scores_db:
        return None
    columns = zip(*scores_db, strict=True)
    return tuple(math.fsum(column) / len(column) for column in columns)
