"""Slices of a source as slices of the edited stream, coded again; what comes out as it was keeps
its packet."""

from __future__ import annotations

from collections.abc import Iterable, Iterator

from codec.coders.coder import EncodedChunk
from codec.coders.effort import Effort
from codec.slots.slotdecoder import SlotDecoder
from codec.slots.slotencoder import SlotEncoder
from codec.stream.manifest import MASKS, Part, snapshot_part
from codec.stream.object import encode_packet

from .arrangement import Arrangement
from .derive import derive
from .edit import Edit
from .segmentfiles import SegmentFiles
from .walk import SourceSlice, Walk


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
            chunks: list[tuple[Part, EncodedChunk]] = [(MASKS, encoded.mask)]
            chunks += enumerate(encoded.changes)
            if birth == layout.segment_start(birth):
                snapshots = enumerate(self._encoder.snapshots())
                chunks += [(snapshot_part(layer), chunk) for layer, chunk in snapshots]
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
