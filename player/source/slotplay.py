"""Snapshots and slices of version 2, as they come, to the slices that a playout takes.

Rule: pure. Chunks come in, decompressed, in the order in which they are due; what does not belong
is a CorruptError.
"""

from __future__ import annotations

from collections.abc import Sequence

from codec.errors import CorruptError
from codec.slice import Slice, window_births
from codec.slots.slotdecoder import Blamed, SlotDecoder
from codec.stream.manifest import Manifest

from .source import ReceivedSlice


class SlotPlay:
    """Slots from the first frame of a playback on: the slices of its window whole, then those that
    change rows.

    Call `join`, `load` the snapshots, `apply` the slices behind them, and hand out what is `ready`.
    After a gap join anew: what was handed out stays, and each birth is handed out once. Layers that
    are missing are hidden. What a snapshot brings back shows lane by lane, within a window: the
    next slice of each lane is whole.
    """

    def __init__(self, manifest: Manifest, num_layers: int, first_frame: int) -> None:
        self._layout = manifest.slot_layout
        self._first_frame = first_frame
        self._decoder = SlotDecoder(self._layout, num_layers)
        self.next_birth = window_births(first_frame, manifest.swin_size).start
        """Birth of the slice that is handed out next."""
        self._whole_until = self.next_birth
        self._changed: Slice | None = None
        self._layers = 0
        self._wire_bytes = 0  # of all that came since a slice was handed out
        self._last_bytes = 0  # of the slice that was applied last
        self._segment_start = 0
        self.join(first_frame)

    @property
    def num_layers(self) -> int:
        """The most layers that slices and snapshots may bring."""
        return self._decoder.num_layers

    def join(self, frame: int) -> None:
        """Begins with the segment of `frame`; nothing that was known before is used."""
        self._decoder.clear()
        self._segment_start = self._layout.segment_start(frame)
        self._changed = None
        self._layers = 0

    def load(self, frame: int, layer: int, snapshot: bytes, wire_bytes: int) -> None:
        """Takes in the snapshot of `layer` at `frame`. Raises a CodecError."""
        decoder = self._decoder
        expected = self._segment_start if decoder.frame is None else decoder.frame
        if frame != expected:
            raise CorruptError(f"snapshot: of frame {frame}, the slices have come to {expected}")
        if layer >= self.num_layers:
            raise CorruptError(f"snapshot: of layer {layer}, at most {self.num_layers} are wanted")
        if self._changed is None and layer != self._layers:
            raise CorruptError(
                f"snapshot: of layer {layer} where that of {self._layers} belongs first"
            )
        decoder.load(snapshot, layer, frame)
        self._layers = max(self._layers, layer + 1)
        self._wire_bytes += wire_bytes
        self._whole_until = self.next_birth + self._layout.swin_size

    def check(self, birth: int, num_layers: int) -> None:
        """Raises CorruptError unless `apply` may get the slice born at `birth` with so many
        changes."""
        frame = self._decoder.frame
        if frame is None:
            raise CorruptError(f"the slice born at {birth} came before a snapshot")
        if birth != frame + 1:
            raise CorruptError(f"the slice born at {birth} came before {frame + 1}")
        if num_layers > self.num_layers:
            raise CorruptError(
                f"the slice born at {birth} has {num_layers} layers, at most {self.num_layers}"
            )

    def apply(
        self, birth: int, mask: bytes, changes: Sequence[bytes], wire_bytes: int, blamed: Blamed
    ) -> None:
        """Takes in the slice born at `birth`, with the changes of layers 0, 1, ..., which `check`
        passes. Raises a CodecError; blamed: see `SlotDecoder.apply`."""
        self._changed = self._decoder.apply(birth, mask, changes, blamed)
        self._layers = len(changes)
        self._wire_bytes += wire_bytes
        self._last_bytes = wire_bytes

    def ready(self) -> list[ReceivedSlice]:
        """The slices to hand out now: none yet, one, or at first a whole window.

        After snapshots call it only once all of that frame are loaded.
        """
        frame = self._decoder.frame
        if frame is None or frame < self._first_frame:
            return []
        made = []
        for birth in range(self.next_birth, frame + 1):
            changed = None if birth < self._whole_until else self._changed
            slice = self._decoder.whole(birth) if changed is None else changed
            # What came before the slice of this frame is counted for the first one.
            wire_bytes = self._last_bytes if birth == frame else 0
            if birth == self.next_birth:
                wire_bytes = self._wire_bytes - (0 if birth == frame else self._last_bytes)
            made.append(ReceivedSlice(slice, self._layers, wire_bytes))
        if made:
            self.next_birth = frame + 1
            self._wire_bytes = self._last_bytes = 0
        return made
