"""The records of a /play response to packets: what stays the same when a connection breaks.

Rule: no I/O. Layer 0 of the slices comes without a gap; a new connection may repeat some.
"""

from __future__ import annotations

from codec.errors import CodecError, CorruptError
from codec.framerange import FrameRange
from codec.slice import window_births
from codec.stream.manifest import MASKS, Manifest, Part
from codec.stream.playrecord import SliceRecord, SnapshotRecord

from .source import Packets, SlicePackets, SnapshotPackets


class Receiver:
    """Checks what the records of one stream bring against its manifest, and against each other."""

    def __init__(self, name: str, manifest: Manifest, num_layers: int, frames: FrameRange) -> None:
        """num_layers: the most that may come."""
        self._name = name
        self._manifest = manifest
        self._num_layers = num_layers
        self._first_frame = self._asked_frame = frames.first
        self.next_birth = window_births(frames.first, manifest.swin_size).start
        """The first birth of which layer 0 has not come."""
        self._joined = not manifest.has_slots

    def rejoin(self, num_frames: int) -> int:
        """The frame to ask for after a break, of a stream of `num_frames` frames."""
        if self._manifest.has_slots:
            # At the edge of a live stream the next frame is not there yet.
            self._joined = False
            self._asked_frame = max(min(self.next_birth, num_frames - 1), self._first_frame)
            return self._asked_frame
        # The window of this frame begins with the missing slice; near the end there is no such
        # frame, and the window of the last one begins with slices that came already.
        frame = min(self.next_birth + self._manifest.swin_size, num_frames) - 1
        return max(frame, self._first_frame)

    def take(self, record: SliceRecord | SnapshotRecord) -> Packets:
        """The packets of `record`. Raises a CodecError that names what is wrong."""
        end_layer = record.first_layer + len(record.packets)
        if end_layer > self._num_layers:
            what = "a snapshot" if isinstance(record, SnapshotRecord) else "a slice"
            raise CorruptError(
                f"{self._name}: {what} with layer {end_layer - 1}, of {self._num_layers} layers"
            )
        if isinstance(record, SnapshotRecord):
            return self._snapshots(record)
        return self._slice(record)

    def _snapshots(self, record: SnapshotRecord) -> Packets:
        manifest, frame = self._manifest, record.frame
        if not manifest.has_slots:
            raise CorruptError(f"{self._name}: a snapshot in a stream of whole slices")
        if frame % manifest.segment_frames:
            raise CorruptError(
                f"{self._name}: a snapshot of frame {frame}, which begins no segment"
            )
        if not self._joined:
            first = manifest.slot_layout.segment_start(self._asked_frame)
            if record.first_layer or frame != first:
                raise CorruptError(
                    f"{self._name}: it begins with the snapshot of layer {record.first_layer} at "
                    f"{frame}, not with that of layer 0 at {first}"
                )
            self._joined = True
            self.next_birth = max(self.next_birth, frame + 1)

        def blame(error: CodecError, part: Part) -> CodecError:
            layer = str(part).rpartition("-")[2]
            return error.within(f"{self._name}: layer {layer} of the snapshot of frame {frame}")

        return SnapshotPackets(frame, record.first_layer, record.packets, blame)

    def _slice(self, record: SliceRecord) -> Packets:
        birth = record.birth
        what = f"the slice born at {birth}"
        if not self._joined:
            raise CorruptError(f"{self._name}: {what} came before a snapshot")
        if record.first_layer == 0:
            if birth > self.next_birth:
                raise CorruptError(f"{self._name}: {what} came before {self.next_birth}")
            if self._manifest.has_slots and record.mask is None:
                raise CorruptError(f"{self._name}: {what} has no mask")
            if not record.packets:
                raise CorruptError(f"{self._name}: {what} has no layers")
            self.next_birth = max(self.next_birth, birth + 1)

        def blame(error: CodecError, part: Part) -> CodecError:
            place = "the mask" if part == MASKS else f"layer {part}"
            return error.within(f"{self._name}: {place} of {what}")

        mask = record.mask if self._manifest.has_slots else None
        return SlicePackets(birth, record.first_layer, record.packets, mask, blame)
