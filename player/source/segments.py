"""Slices from whole objects, segment by segment: what a folder and a static host have in common.

Rule: no I/O; whoever fetches asks which parts of which segment are wanted.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping

from codec.errors import CodecError
from codec.framerange import FrameRange
from codec.slice import window_births
from codec.slots.slotdecoder import Blamed
from codec.stream.integrity import CheckedObject, fitting_slice
from codec.stream.manifest import MASKS, Manifest, Part, snapshot_part

from .slotplay import SlotPlay
from .source import ReceivedSlice

Objects = Mapping[Part, CheckedObject]
"""The objects of one segment."""


class SegmentPlay:
    """The slices of `num_layers` layers that `frames` need, in order of birth.

    While `segment` is a number, get its `parts` and iterate over all of their `slices`.
    """

    def __init__(self, manifest: Manifest, num_layers: int, frames: FrameRange) -> None:
        self._manifest = manifest
        self._num_layers = num_layers
        self._end = frames.end
        self._slots: SlotPlay | None = None
        self._first_birth = window_births(frames.first, manifest.swin_size).start
        self._next_segment = manifest.segment_of(self._first_birth)
        if manifest.has_slots:
            self._slots = SlotPlay(manifest, num_layers, frames.first)
            self._first_birth = manifest.segment_of(frames.first) * manifest.segment_frames
            self._next_segment = manifest.segment_of(frames.first)
        self._joined = False

    @property
    def segment(self) -> int | None:
        """The segment that is wanted next; None if none is."""
        first_frame = self._next_segment * self._manifest.segment_frames
        over = self._end is not None and first_frame >= self._end
        return None if over else self._next_segment

    @property
    def parts(self) -> list[Part]:
        """What is wanted of that segment, in the order in which it is used."""
        layers = range(self._num_layers)
        if self._slots is None:
            return [*layers]
        snapshots = [] if self._joined else list(map(snapshot_part, layers))
        return [*snapshots, MASKS, *layers]

    def slices(self, objects: Objects) -> Iterator[ReceivedSlice]:
        """The slices that the segment adds, decoded as they are asked for. objects: its `parts`.

        Raises a CodecError that names the object at fault.
        """
        if self._slots is None:
            yield from self._whole(objects)
        else:
            yield from self._changes(self._slots, objects)
        self._joined = True
        self._next_segment += 1

    def _births(self, objects: Objects) -> Iterator[int]:
        """The births of the segment that are wanted."""
        for birth in objects[0].births:
            if self._end is not None and birth >= self._end:
                return
            if birth >= self._first_birth:
                yield birth

    def _whole(self, objects: Objects) -> Iterator[ReceivedSlice]:
        layers = range(self._num_layers)
        for birth in self._births(objects):
            chunks = (objects[layer].chunk(birth) for layer in layers)
            slice = fitting_slice(chunks, self._manifest, lambda layer: objects[layer].name)
            wire_bytes = sum(len(objects[layer].packet(birth)) for layer in layers)
            yield ReceivedSlice(slice, len(layers), wire_bytes)

    def _changes(self, play: SlotPlay, objects: Objects) -> Iterator[ReceivedSlice]:
        if not self._joined:
            frame = self._first_birth
            for layer in range(self._num_layers):
                found = objects[snapshot_part(layer)]
                snapshot = found.content(frame)
                try:
                    play.load(frame, layer, snapshot, len(found.packet(frame)))
                except CodecError as error:
                    raise found.blamed(error, frame) from error
            # The slice of this frame is in the snapshots.
            self._first_birth += 1
            yield from play.ready()
        parts: list[Part] = [MASKS, *range(self._num_layers)]
        for birth in self._births(objects):
            mask, *changes = [objects[part].content(birth) for part in parts]
            wire_bytes = sum(len(objects[part].packet(birth)) for part in parts)
            play.apply(birth, mask, changes, wire_bytes, _blamed(objects, birth))
            yield from play.ready()


def _blamed(objects: Objects, birth: int) -> Blamed:
    """Makes an error name the object of a segment that is at fault."""
    return lambda error, layer: objects[MASKS if layer is None else layer].blamed(error, birth)
