"""The slices of a stream in turn, decoded and as they lie in its files."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from codec.arrays import Bytes
from codec.errors import InvalidError
from codec.slice import window_births
from codec.slots.mask import decode_mask
from codec.slots.slotdecoder import SlotDecoder
from codec.slots.slotlayout import SlotLayout
from codec.slots.slotstate import Slots, holds
from codec.slots.update import KEPT, NEW
from codec.stream.integrity import CheckedObject
from codec.stream.manifest import MASKS, Part
from codec.stream.reader import StreamReader
from codec.stream.seeker import roll

from .edit import Turn


@dataclass(frozen=True, slots=True)
class SourceSlice:
    """A slice, and what its lane holds after it."""

    birth: int
    statuses: Bytes  # (S,)
    lane: list[Slots]
    """Layer after layer; not to be altered, and valid until the next slice."""

    def turns(self, layout: SlotLayout) -> Iterator[Turn]:
        """The slice, layer after layer."""
        lane = layout.lane(self.birth)
        for layer, slots in enumerate(self.lane):
            statuses = self.statuses[layout.row_edges[layer] : layout.row_edges[layer + 1]]
            yield Turn(self.birth, lane, layer, layout.lattices[layer], statuses, slots)


class Walk:
    """Goes through a stream slice by slice; holds the objects of one segment, and what the slots
    hold."""

    def __init__(self, reader: StreamReader) -> None:
        self.reader = reader
        self._objects: dict[Part, CheckedObject] = {}
        self._segment = -1
        self._decoder = SlotDecoder(reader.manifest.slot_layout)

    def opening(self, frame: int) -> Iterator[SourceSlice]:
        """The slices that show at `frame`, oldest first, as if what they show were new in them."""
        self._seek(frame)
        for birth in window_births(frame, self._decoder.layout.swin_size):
            yield self._whole(birth)

    def slices(self, births: range) -> Iterator[SourceSlice]:
        """The slices of `births`, which begin behind frame 0."""
        if births and self._decoder.frame != births[0] - 1:
            self._seek(births[0] - 1)
        for birth in births:
            yield self._next(birth)

    def replacing(self, births: range) -> Iterator[SourceSlice]:
        """The slices of `births`, from 0 on, which bring what the stream shows to lanes that hold
        something else: what each lane shows in its first turn is new."""
        self._seek(0)
        for birth in births:
            found = self._next(birth) if birth else self._whole(0)
            yield found if birth >= len(self._decoder.lanes) else self._whole(birth)

    def decoder(self, frame: int) -> SlotDecoder:
        """The state of a reader at `frame`; not to be altered, and valid until the walk goes on."""
        if self._decoder.frame != frame:
            self._seek(frame)
        return self._decoder

    def content(self, birth: int, part: Part) -> tuple[bytes, bytes]:
        """The chunk of `part` in the slice of `birth`, and its packet as it is; none of both if it
        has none."""
        found = self._object(self.reader.manifest.segment_of(birth), part)
        return found.content(birth), found.packet(birth)

    def _seek(self, frame: int) -> None:
        if not 0 <= frame < self.reader.num_frames:
            raise InvalidError(f"{self.reader.name} has no frame {frame}")
        self._decoder = self.reader.decoder_at(frame, self.reader.manifest.num_layers)

    def _next(self, birth: int) -> SourceSlice:
        decoder, manifest = self._decoder, self.reader.manifest
        layout, history = decoder.layout, decoder.history.of(birth).copy()
        roll(self._object, manifest, birth, decoder)
        mask = self._object(manifest.segment_of(birth), MASKS).content(birth)
        statuses = decode_mask(layout, birth, mask, history)
        return SourceSlice(birth, statuses, decoder.lanes[layout.lane(birth)])

    def _whole(self, birth: int) -> SourceSlice:
        """All that the lane of `birth` holds, as new."""
        lane = self._decoder.lanes[self._decoder.layout.lane(birth)]
        held = np.concatenate([holds(slots.conditions) for slots in lane])
        return SourceSlice(birth, np.where(held, NEW, KEPT).astype(np.uint8), lane)

    def _object(self, segment: int, part: Part) -> CheckedObject:
        if segment != self._segment:
            self._objects, self._segment = {}, segment
        if part not in self._objects:
            self._objects[part] = self.reader.read_object(segment, part)
        return self._objects[part]
