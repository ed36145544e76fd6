"""State of a reader (section 7), written from codec/FORMAT.md alone."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field, replace

from tests.goldens.decoder import (
    CHANGE,
    ENDED,
    KEPT,
    NEW,
    PREDICTED,
    SKIP_MAP,
    Hole,
    Shape,
    Slot,
    Statuses,
    decode_change,
    decode_head,
    decode_keyframe,
    decode_skip_map,
    predict,
)


@dataclass
class AppliedSlice:
    """A slice as it was applied, kept so that a late packet can still be used."""

    birth: int
    skip_map: bytes | None
    changes: dict[int, bytes]  # by layer
    before: dict[int, list[Slot]]  # by layer
    statuses: Statuses | None = field(default=None)  # None: it counts as missing


class Reader:
    """A reader of a stream; a refused chunk counts as missing."""

    def __init__(self, shape: Shape) -> None:
        self.shape = shape
        self.lanes: list[list[list[Slot]]] = [  # [lane][layer][slot]
            [[Hole.UNKNOWN] * count for count in shape.slots] for _ in range(shape.swin_size)
        ]
        self.applied: dict[int, AppliedSlice] = {}

    def load(self, chunk: bytes) -> None:
        """Loads a keyframe, which replaces any state of the layer."""
        try:
            head, lanes = decode_keyframe(chunk, self.shape)
            assert head.birth >= 0
            assert head.birth % self.shape.segment_frames == 0
        except AssertionError:
            return
        for slice_ in self.applied.values():  # an earlier packet has no effect
            if slice_.birth <= head.birth:
                slice_.before.pop(head.layer, None)
        for i, lane in enumerate(lanes):
            birth = head.birth - self.shape.swin_size + 1 + i
            self.lanes[birth % self.shape.swin_size][head.layer] = lane
            later = birth + self.shape.swin_size
            if later in self.applied:  # the keyframe is late
                self.applied[later].before[head.layer] = lane
                self.apply_again(later)

    def apply(self, birth: int, skip_map: bytes | None, changes: dict[int, bytes]) -> None:
        """Applies one slice: its skip map, and the received changes, by layer. An empty one means
        that nothing changes."""
        lane = self.lanes[birth % self.shape.swin_size]
        self.applied[birth] = AppliedSlice(birth, skip_map, dict(changes), dict(enumerate(lane)))
        self.apply_again(birth)

    def late(self, birth: int, layer: int, chunk: bytes) -> None:
        """Applies a change that arrives late."""
        self.applied[birth].changes[layer] = chunk
        self.apply_again(birth)

    def apply_again(self, birth: int) -> None:
        """Applies a slice again, with the later ones of its lane."""
        swin_size = self.shape.swin_size
        slices = [s for b, s in self.applied.items() if b >= birth and (b - birth) % swin_size == 0]
        for slice_ in slices:
            slice_.statuses = self.statuses(slice_)
        for layer in range(len(self.shape.slots)):
            since_keyframe = [slice_ for slice_ in slices if layer in slice_.before]
            if since_keyframe:
                slots = since_keyframe[0].before[layer]
                for slice_ in since_keyframe:
                    slice_.before[layer] = slots
                    slots = self.after(slice_, layer)
                self.lanes[birth % swin_size][layer] = slots

    def statuses(self, slice_: AppliedSlice) -> Statuses | None:
        """The statuses of the skip map; None if it is missing or unreadable."""
        if slice_.skip_map is None:
            return None
        first = slice_.birth - slice_.birth % self.shape.segment_frames
        try:
            before = list(self.skip_maps_before(slice_.birth, first))
            if not slice_.skip_map:
                return [[KEPT] * count for count in self.shape.slots]
            assert decode_head(slice_.skip_map, SKIP_MAP, self.shape).birth == slice_.birth
            return decode_skip_map(slice_.skip_map[12:], self.shape.slots, before)
        except AssertionError:
            return None

    def skip_maps_before(self, birth: int, first: int) -> Iterator[Statuses]:
        for earlier in (birth - self.shape.swin_size, birth - 2 * self.shape.swin_size):
            if earlier > first:
                assert earlier in self.applied
                statuses = self.applied[earlier].statuses
                assert statuses is not None
                yield statuses

    def after(self, slice_: AppliedSlice, layer: int) -> list[Slot]:
        """The slots of a layer after the slice."""
        before = slice_.before[layer]
        if slice_.statuses is None:
            return [Hole.UNKNOWN] * len(before)
        if layer in slice_.changes:
            try:
                return self.changed(slice_, slice_.statuses[layer], layer)
            except AssertionError:
                pass
        known: list[dict[int, Slot]] = [{KEPT: slot, ENDED: Hole.EMPTY} for slot in before]
        statuses = slice_.statuses[layer]
        return [k.get(s, Hole.UNKNOWN) for k, s in zip(known, statuses, strict=True)]

    def changed(self, slice_: AppliedSlice, statuses: list[int], layer: int) -> list[Slot]:
        """The slots of a layer after the slice, with its change."""
        chunk = slice_.changes[layer]
        counts = (statuses.count(PREDICTED), statuses.count(NEW))
        if not chunk:
            assert counts == (0, 0)
            pairs = zip(slice_.before[layer], statuses, strict=True)
            return [Hole.EMPTY if status == ENDED else slot for slot, status in pairs]
        head = decode_head(chunk, CHANGE, self.shape)
        assert (head.layer, head.birth) == (layer, slice_.birth)
        change = decode_change(chunk[12:], self.shape, layer, counts, head.has_starts)
        residuals, gaussians = iter(change.predicted), iter(change.new)
        lattice = self.shape.lattice[layer]
        slots: list[Slot] = []
        for status, slot in zip(statuses, slice_.before[layer], strict=True):
            if status == KEPT:
                slots.append(slot)
            elif status == ENDED:
                slots.append(Hole.EMPTY)
            elif status == PREDICTED:
                slots.append(predict(slot, next(residuals), slice_.birth, lattice))
            else:
                gaussian = next(gaussians)
                slots.append(replace(gaussian, start=slice_.birth + gaussian.start))
        return slots
