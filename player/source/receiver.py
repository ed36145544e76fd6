"""The records of a /play response to slices: what stays the same when a connection breaks.

Rule: no I/O. Each birth is handed out once and in order, whatever a new connection repeats.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Protocol

from codec.errors import CodecError, CorruptError
from codec.framerange import FrameRange
from codec.slice import window_births
from codec.stream.chunk import Chunk
from codec.stream.integrity import decode_fitting_packet, fitting_slice
from codec.stream.manifest import MASKS, Manifest, Part, snapshot_part
from codec.stream.object import packet_content
from codec.stream.playrecord import SliceRecord, SnapshotRecord

from .slotplay import SlotPlay
from .source import ReceivedSlice


class Receiver(Protocol):
    """What one version makes of slices and snapshots."""

    @property
    def next_birth(self) -> int:
        """Birth of the slice that is handed out next."""
        ...

    def rejoin(self, num_frames: int) -> int:
        """The frame to ask for after a break, of a stream of `num_frames` frames. What comes next
        is the answer to that."""
        ...

    def take(self, record: SliceRecord | SnapshotRecord) -> Iterator[ReceivedSlice]:
        """The slices to hand out, now that `record` has come. Raises a CodecError that names
        what is wrong."""
        ...

    def finish(self) -> Iterator[ReceivedSlice]:
        """The slices to hand out because no record follows."""
        ...


def open_receiver(name: str, manifest: Manifest, layers: int, frames: FrameRange) -> Receiver:
    """What receives the slices of `layers` layers at most, for `frames` of the stream `name`."""
    if manifest.has_slots:
        return SlotReceiver(name, manifest, layers, frames.first)
    return SliceReceiver(name, manifest, frames)


class SliceReceiver:
    """Version 1: every slice is whole."""

    def __init__(self, name: str, manifest: Manifest, frames: FrameRange) -> None:
        self._name = name
        self._manifest = manifest
        self._first_frame = frames.first
        self.next_birth = window_births(frames.first, manifest.swin_size).start

    def rejoin(self, num_frames: int) -> int:
        # The window of this frame begins with the missing slice; near the end there is no such
        # frame, and the window of the last one begins with slices that came already.
        frame = min(self.next_birth + self._manifest.swin_size, num_frames) - 1
        return max(frame, self._first_frame)

    def take(self, record: SliceRecord | SnapshotRecord) -> Iterator[ReceivedSlice]:
        if isinstance(record, SnapshotRecord):
            raise CorruptError(f"{self._name}: a snapshot in a stream of whole slices")
        if record.birth < self.next_birth:
            return
        if record.birth != self.next_birth:
            message = f"the slice born at {record.birth} came before {self.next_birth}"
            raise CorruptError(f"{self._name}: {message}")
        if not record.packets:
            raise CorruptError(f"{self._name}: the slice born at {record.birth} has no layers")
        slice = fitting_slice(
            self._chunks(record), self._manifest, lambda layer: self._name_of(record, layer)
        )
        self.next_birth += 1
        yield ReceivedSlice(slice, len(record.packets), sum(map(len, record.packets)))

    def finish(self) -> Iterator[ReceivedSlice]:
        return iter(())

    def _chunks(self, record: SliceRecord) -> Iterator[Chunk]:
        for layer, packet in enumerate(record.packets):
            try:
                chunk = decode_fitting_packet(packet, self._manifest, record.birth, layer)
            except CodecError as error:
                raise error.within(self._name_of(record, layer)) from error
            yield chunk

    def _name_of(self, record: SliceRecord, layer: int) -> str:
        return f"{self._name}: layer {layer} of the slice born at {record.birth}"


class SlotReceiver:
    """Version 2: snapshots first, then what changes."""

    def __init__(self, name: str, manifest: Manifest, layers: int, first_frame: int) -> None:
        self._name = name
        self._manifest = manifest
        self._play = SlotPlay(manifest, layers, first_frame)
        self._first_frame = first_frame

    @property
    def next_birth(self) -> int:
        return self._play.next_birth

    def rejoin(self, num_frames: int) -> int:
        # At the edge of a live stream the next frame is not there yet.
        frame = max(min(self.next_birth, num_frames - 1), self._first_frame)
        self._play.join(frame)
        return frame

    def take(self, record: SliceRecord | SnapshotRecord) -> Iterator[ReceivedSlice]:
        if isinstance(record, SnapshotRecord):
            self._load(record)
            return
        # Now all the snapshots have come, and the slice before is as it will be.
        yield from self._play.ready()
        self._apply(record)
        yield from self._play.ready()

    def finish(self) -> Iterator[ReceivedSlice]:
        yield from self._play.ready()

    def _load(self, record: SnapshotRecord) -> None:
        for layer, packet in enumerate(record.packets, record.first_layer):
            name = f"{self._name}: layer {layer} of the snapshot of frame {record.frame}"
            try:
                if layer >= self._manifest.num_layers:
                    raise CorruptError(f"the stream has {self._manifest.num_layers} layers")
                snapshot = self._content(packet, snapshot_part(layer))
                self._play.load(record.frame, layer, snapshot, len(packet))
            except CodecError as error:
                raise error.within(name) from error

    def _apply(self, record: SliceRecord) -> None:
        what = f"the slice born at {record.birth}"
        if record.mask is None:
            raise CorruptError(f"{self._name}: {what} has no mask")
        try:
            self._play.check(record.birth, len(record.packets))
        except CodecError as error:
            raise error.within(self._name) from error
        names = [f"{self._name}: layer {n} of {what}" for n in range(len(record.packets))]
        mask_name = f"{self._name}: the mask of {what}"

        def blamed(error: CodecError, layer: int | None) -> CodecError:
            return error.within(mask_name if layer is None else names[layer])

        contents: list[bytes] = []
        parts: list[Part] = [MASKS, *range(len(record.packets))]
        for part, packet in zip(parts, (record.mask, *record.packets), strict=True):
            try:
                contents.append(self._content(packet, part))
            except CodecError as error:
                raise blamed(error, part if type(part) is int else None) from error
        wire_bytes = len(record.mask) + sum(map(len, record.packets))
        self._play.apply(record.birth, contents[0], contents[1:], wire_bytes, blamed)

    def _content(self, packet: bytes, part: Part) -> bytes:
        return packet_content(packet, self._manifest.max_content_bytes(part))
