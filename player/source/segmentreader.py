"""Packets from whole objects, segment by segment: what a folder and a static host have in common.

Rule: no I/O; the caller asks which parts of which segment are wanted, and fetches them.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping

from codec.framerange import FrameRange
from codec.stream.integrity import CheckedObject
from codec.stream.manifest import MASKS, Manifest, Part, snapshot_part

from .source import Blame, Packets, SlicePackets, SnapshotPackets

Objects = Mapping[Part, CheckedObject]
"""The objects of one segment."""


class SegmentReader:
    """The packets of `num_layers` layers that `frames` need, in order of birth.

    While `segment` is a number, get its `parts` and iterate over all of their `packets`.
    """

    def __init__(self, manifest: Manifest, num_layers: int, frames: FrameRange) -> None:
        self._manifest = manifest
        self._num_layers = num_layers
        self._end = frames.end
        self._next_segment = manifest.segment_of(frames.first)
        # The slice of a segment's first frame is in its snapshots.
        self._first_birth = self._next_segment * manifest.segment_frames + 1
        self._joined = False

    @property
    def segment(self) -> int | None:
        """The segment that is wanted next; None if none is."""
        first_frame = self._next_segment * self._manifest.segment_frames
        over = self._end is not None and first_frame >= self._end
        return None if over else self._next_segment

    @property
    def parts(self) -> list[Part]:
        """Parts of that segment to get, in the order of their use."""
        layers = range(self._num_layers)
        snapshots = [] if self._joined else list(map(snapshot_part, layers))
        return [*snapshots, MASKS, *layers]

    def packets(self, objects: Objects) -> Iterator[Packets]:
        """The packets that the segment adds. objects: its `parts`."""
        layers = range(self._num_layers)
        if not self._joined:
            frame = self._next_segment * self._manifest.segment_frames
            snapshots = tuple(objects[snapshot_part(layer)].packet(frame) for layer in layers)
            yield SnapshotPackets(frame, 0, snapshots, _blame(objects, frame))
            self._joined = True
        for birth in objects[0].births:
            if self._end is not None and birth >= self._end:
                break
            if birth >= self._first_birth:
                packets = tuple(objects[layer].packet(birth) for layer in layers)
                mask = objects[MASKS].packet(birth)
                yield SlicePackets(birth, 0, packets, mask, _blame(objects, birth))
        self._next_segment += 1


def _blame(objects: Objects, birth: int) -> Blame:
    """Makes an error name the object of a segment that is at fault."""
    return lambda error, part: objects[part].blamed(error, birth)
