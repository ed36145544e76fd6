"""The records of a /play response to packets: what stays the same when a connection breaks.

Rule: no I/O. Layer 0 of the slices comes without a gap; a new connection may repeat some.
"""

from __future__ import annotations

from codec.errors import CodecError, CorruptError
from codec.framerange import FrameRange
from codec.stream.manifest import MASKS, Manifest, Part, snapshot_part
from codec.stream.playrecord import SliceRecord, SnapshotRecord

from .sizelimits import SizeLimits
from .source import Blame, Packets, SlicePackets, SnapshotPackets

KEPT_BIRTHS = 1 << 14
"""Slices behind the newest one of which is known what came; what comes of older ones is of no
use."""


class PlayReceiver:
    """Checks what the records of one stream bring against its manifest, and against each other."""

    def __init__(self, name: str, manifest: Manifest, num_layers: int, frames: FrameRange) -> None:
        """num_layers: the most that may come."""
        self._name = name
        self._manifest = manifest
        self._num_layers = num_layers
        self._first_frame = self._asked_frame = frames.first
        self.next_birth = manifest.slot_layout.segment_start(frames.first)
        """The first birth of which layer 0 has not come."""
        self._joined = False
        self._limits = SizeLimits(manifest)
        self._oldest = self.next_birth
        self._end = frames.end
        # Layers that have arrived, one bit for each, by birth and by frame.
        self._slices: dict[int, int] = {}
        self._snapshots: dict[int, int] = {}

    def rejoin(self, num_frames: int) -> int:
        """The frame to ask for after a break, of a stream of `num_frames` frames."""
        # At the edge of a live stream the next frame is not there yet.
        self._joined = False
        self._asked_frame = max(min(self.next_birth, num_frames - 1), self._first_frame)
        return self._asked_frame

    def ingest(self, record: SliceRecord | SnapshotRecord) -> Packets | None:
        """Packets of `record`; None if they came already, or were not requested.
        Raises a CodecError that names what is wrong."""
        end_layer = record.first_layer + len(record.packets)
        if end_layer > self._num_layers:
            what = "a snapshot" if isinstance(record, SnapshotRecord) else "a slice"
            raise CorruptError(
                f"{self._name}: {what} has layer {end_layer - 1}; this play has {self._num_layers} "
                "layers"
            )
        if isinstance(record, SnapshotRecord):
            return self._ingest_snapshots(record)
        return self._ingest_slice(record)

    def _ingest_snapshots(self, record: SnapshotRecord) -> Packets | None:
        manifest, frame = self._manifest, record.frame
        if frame % manifest.segment_frames:
            raise CorruptError(
                f"{self._name}: a snapshot of frame {frame} arrived, which does not begin a segment"
            )

        def blame(error: CodecError, part: Part) -> CodecError:
            layer = str(part).rpartition("-")[2]
            return error.within(f"{self._name}: layer {layer} of the snapshot of frame {frame}")

        numbered = enumerate(record.packets, record.first_layer)
        self._check_packets([(snapshot_part(layer), packet) for layer, packet in numbered], blame)
        if not self._joined:
            first = manifest.slot_layout.segment_start(self._asked_frame)
            if record.first_layer or frame != first:
                raise CorruptError(
                    f"{self._name}: the play begins with layer {record.first_layer} of the "
                    f"snapshot of frame {frame}, not with layer 0 of the snapshot of frame {first}"
                )
            self._joined = True
            self.next_birth = max(self.next_birth, frame + 1)
        if not self._is_asked(frame):
            return None
        first_layer, packets = _fresh(self._snapshots, frame, record)
        return SnapshotPackets(frame, first_layer, packets, blame) if packets else None

    def _ingest_slice(self, record: SliceRecord) -> Packets | None:
        birth = record.birth
        what = f"the slice born at {birth}"
        if not self._joined:
            raise CorruptError(f"{self._name}: {what} arrived before a snapshot")
        if self._end is not None and birth >= self._end:
            raise CorruptError(
                f"{self._name}: {what} arrived, but the play ends before frame {self._end}"
            )

        def blame(error: CodecError, part: Part) -> CodecError:
            place = "the mask" if part == MASKS else f"layer {part}"
            return error.within(f"{self._name}: {place} of {what}")

        parts: list[tuple[Part, bytes]] = [*enumerate(record.packets, record.first_layer)]
        if record.mask is not None:
            parts.append((MASKS, record.mask))
        self._check_packets(parts, blame)
        if record.first_layer == 0:
            if birth > self.next_birth:
                raise CorruptError(
                    f"{self._name}: {what} arrived before the slice born at {self.next_birth}"
                )
            if record.mask is None:
                raise CorruptError(f"{self._name}: {what} has no mask")
            if not record.packets:
                raise CorruptError(f"{self._name}: {what} has no layers")
            self.next_birth = max(self.next_birth, birth + 1)
            self._forget()
        if not self._is_asked(birth):
            return None
        first_layer, packets = _fresh(self._slices, birth, record)
        mask = None if first_layer else record.mask
        return SlicePackets(birth, first_layer, packets, mask, blame) if packets else None

    def _check_packets(self, parts: list[tuple[Part, bytes]], blame: Blame) -> None:
        for part, packet in parts:
            try:
                self._limits.check_packet(packet, part)
            except CodecError as error:
                raise blame(error, part) from error

    def _is_asked(self, birth: int) -> bool:
        """Whether a slice, or a snapshot, of `birth` is neither too old nor far too early."""
        manifest = self._manifest
        ahead = max(manifest.swin_size, 2 * manifest.segment_frames)
        return self._oldest <= birth < self.next_birth + ahead

    def _forget(self) -> None:
        """Drops what is known of slices that are too old to be of use."""
        while self._oldest < self.next_birth - KEPT_BIRTHS:
            self._slices.pop(self._oldest, None)
            self._snapshots.pop(self._oldest, None)
            self._oldest += 1


def _fresh(
    arrived: dict[int, int], at: int, record: SliceRecord | SnapshotRecord
) -> tuple[int, tuple[bytes, ...]]:
    """Notes that the packets of `record`, born `at`, have arrived. Gives the first layer and the
    packets from the first one that had not to the last one; some between them may have."""
    first_layer, packets, before = record.first_layer, record.packets, arrived.get(at, 0)
    arrived[at] = before | ((1 << len(packets)) - 1) << first_layer
    fresh = [n for n in range(len(packets)) if not before >> (first_layer + n) & 1]
    if not fresh:
        return first_layer, ()
    return first_layer + fresh[0], packets[fresh[0] : fresh[-1] + 1]
