"""Streams of slots for two implementations, with a reader of each: codec.slots, and the plain one
of tests/goldens, which is independent of the package.
"""

from __future__ import annotations

import copy
import struct
from collections.abc import Sequence
from dataclasses import dataclass, fields
from itertools import chain, count

import numpy as np

from codec.errors import CodecError
from codec.lattice.lattice import Lattice
from codec.slice import HIDDEN, Slice
from codec.slots.decoder import SlotDecoder
from codec.slots.encoder import SlotEncoder
from codec.slots.skipmap import decode_skip_map
from codec.slots.slotlayout import SlotLayout, Update
from codec.slots.state import EMPTY, ON_LATTICE, UNKNOWN
from codec.splats import Splats
from tests.goldens import decoder as plain
from tests.goldens.decoder import f32
from tests.goldens.reader import AppliedSlice, Reader
from tests.support.drawn import same_splats

FINE = plain.Lattice(f32(0.001), f32(0.05), -3.0, f32(1 / 127), f32(0.02), 256)
COARSE = plain.Lattice(f32(0.01), f32(0.1), 0.5, f32(0.01), f32(0.03), 16)


def make_shape(
    swin_size: int = 3, segment_frames: int = 7, k: int = 1, slots: tuple[int, ...] = (9, 5)
) -> plain.Shape:
    return plain.Shape(swin_size, segment_frames, k, slots, (FINE, COARSE, FINE)[: len(slots)])


def layout_of(shape: plain.Shape) -> SlotLayout:
    names = [field.name for field in fields(plain.Lattice)]
    lattices = [Lattice(**{n: getattr(one, n) for n in names}) for one in shape.lattice]
    sh_degree = {1: 0, 4: 1, 9: 2, 16: 3}[shape.num_coefficients]
    return SlotLayout(
        shape.swin_size, shape.slots, sh_degree, tuple(lattices), shape.segment_frames
    )


@dataclass(frozen=True)
class Chunks:
    """The chunks of a stream; those of the layers are in a list for each birth from 0 on."""

    skip_maps: list[bytes]
    changes: list[list[bytes]]
    keyframes: dict[int, list[bytes]]
    """Keyframes of the layers, by the first frame of each segment."""

    def slice(self, birth: int) -> tuple[bytes, list[bytes]]:
        """The skip map and the changes of a birth."""
        return self.skip_maps[birth], self.changes[birth]


def encoded_chunks(layout: SlotLayout, updates: Sequence[Update]) -> Chunks:
    """The chunks that codec.slots encodes from `updates`."""
    encoder, made = SlotEncoder(layout), Chunks([], [], {})
    for update in updates:
        slice_ = encoder.append(update)
        if slice_ is None:
            continue
        made.skip_maps.append(slice_.skip_map.data)
        made.changes.append([change.data for change in slice_.changes])
        if update.birth % layout.segment_frames == 0:
            made.keyframes[update.birth] = [chunk.data for chunk in encoder.keyframes()]
    return made


def spelled_out(shape: plain.Shape, chunks: Chunks) -> Chunks:
    """`chunks` with the packets of slices and layers without changes, which a writer may omit."""
    reader, skip_maps = Reader(shape), []
    for birth, skip_map in enumerate(chunks.skip_maps):
        # Zeros code statuses of KEPT alone, if there are as many as the decoder reads.
        head = _head(plain.SKIP_MAP, birth)
        tries = (AppliedSlice(birth, skip_map or head + bytes(n), {}, {}) for n in count(4))
        slice_ = next(one for one in tries if reader.statuses(one) is not None)
        slice_.statuses = reader.statuses(slice_)
        reader.applied[birth] = slice_
        skip_maps.append(slice_.skip_map or b"")
    changes = [
        [data or _head(plain.CHANGE, birth, layer) + bytes(20) for layer, data in enumerate(row)]
        for birth, row in enumerate(chunks.changes)
    ]
    return Chunks(skip_maps, changes, chunks.keyframes)


def _head(kind: int, birth: int, layer: int = 0) -> bytes:
    return struct.pack("<4sBBBBi", b"SWG1", kind, layer, 0, 0, birth)


def onto(change: Slice, before: Slice) -> Slice:
    """The whole slice after `change`, with rows, is applied to the whole slice before it."""
    arrays = [array.copy() for array in before.splats.arrays]
    for array, new in zip(arrays, change.splats.arrays, strict=True):
        array[change.rows] = new
    offsets = np.where(before.start_offsets == HIDDEN, HIDDEN, 0).astype(np.uint8)
    offsets[change.rows] = change.start_offsets
    return Slice(change.birth, Splats(*arrays), offsets)


Held = list[list[list[object]]]
"""[lane][layer][slot]: a word, or a Gaussian's start, its integers and the bits of its floats. A
start in the past counts as the current frame, because two readers may store it differently."""


def held(decoder: SlotDecoder) -> Held:
    """The state of a decoder of codec.slots."""
    layout, frame = decoder.layout, decoder.frame
    assert frame is not None
    found: Held = [[] for _ in decoder.lanes]
    for part in decoder.window(frame):
        lane = layout.lane(part.birth)
        flat = [array.reshape(len(array), -1) for array in part.splats.arrays]
        for slots, first in zip(decoder.lanes[lane], layout.row_edges, strict=False):
            row: list[object] = []
            for slot, condition in enumerate(slots.conditions):
                offset = int(part.start_offsets[first + slot])
                assert (offset == HIDDEN) == (condition in (UNKNOWN, EMPTY))
                if offset == HIDDEN:
                    if condition == EMPTY:  # nothing shows it, but no rotation is zero
                        assert flat[2][first + slot].tolist() == [1, 0, 0, 0]
                    row.append("unknown" if condition == UNKNOWN else "empty")
                    continue
                bits = b"".join(array[first + slot].tobytes() for array in flat)
                integers = None
                if condition == ON_LATTICE:
                    attributes = slots.states.attributes[slot]
                    signed = attributes[:-1].view(np.int8).tolist()
                    position = slots.states.positions[slot].tolist()
                    integers = (*position, *signed, int(attributes[-1]))
                row.append((max(part.birth + offset, frame), integers, bits))
            found[lane].append(row)
    return found


def plainly_held(reader: Reader, frame: int, num_layers: int) -> Held:
    """The state of layers 0..num_layers-1 in the plain reader."""

    def one(slot: plain.Slot, lattice: plain.Lattice) -> object:
        if isinstance(slot, plain.Hole):
            return slot.value
        f = plain.to_floats(slot, lattice)
        numbers = [*f.mean, *f.log_scales, *f.quat, f.logit_opacity, *chain(*f.sh)]
        integers = None if slot.escaped else (*slot.position, *slot.attributes)
        return max(slot.start, frame), integers, struct.pack(f"<{len(numbers)}f", *numbers)

    lattices = reader.shape.lattice[:num_layers]
    return [
        [[one(slot, lat) for slot in row] for row, lat in zip(lane, lattices, strict=False)]
        for lane in reader.lanes
    ]


class BothReaders:
    """A reader of each implementation. Both receive the same calls, and must have the same state
    after each. `shown` follows the slices that the decoder hands out, as a player does."""

    def __init__(self, shape: plain.Shape, num_layers: int | None = None) -> None:
        self.decoder = SlotDecoder(layout_of(shape), num_layers)
        self.reader = Reader(shape)
        self.shown: dict[int, Slice] = {}

    def check(self) -> None:
        frame, num_layers = self.decoder.frame, self.decoder.num_layers
        assert frame is not None
        assert held(self.decoder) == plainly_held(self.reader, frame, num_layers)

    def load(self, keyframe: bytes) -> None:
        self.decoder.load(keyframe)
        self.reader.load(keyframe)

    def apply(self, birth: int, skip_map: bytes | None, changes: Sequence[bytes | None]) -> None:
        if not self.shown:
            frame = self.decoder.frame
            assert frame is not None
            self.shown = {one.birth % self.swin_size: one for one in self.decoder.hand_out(frame)}
        change = self.decoder.apply(birth, skip_map, changes)
        self._apply_plainly(birth, skip_map, changes)
        self.check()
        # It updates its lane, including keyframes and changes that came late.
        lane, whole = birth % self.swin_size, self.decoder.whole(birth)
        found = self.shown[lane] = onto(change, self.shown[lane])
        assert same_splats(found.splats, whole.splats)
        assert (found.start_offsets == whole.start_offsets).all()

    @property
    def swin_size(self) -> int:
        return self.decoder.layout.swin_size

    def apply_what_fits(self, birth: int, skip_map: bytes, changes: Sequence[bytes | None]) -> None:
        """Applies a slice without the changes that break a rule."""
        fits = [
            data is None or self._fits_plainly(birth, skip_map, [None] * layer + [data])
            for layer, data in enumerate(changes)
        ]
        assert self.decoder.history.is_readable(birth)
        try:
            copy.deepcopy(self.decoder).apply(birth, skip_map, changes)
        except CodecError:
            assert not all(fits)
        else:
            assert all(fits)
        pairs = zip(changes, fits, strict=True)
        self.apply(birth, skip_map, [data if fit else None for data, fit in pairs])

    def late(self, birth: int, layer: int, change: bytes) -> bool:
        """Whether `change` was accepted, or is no longer needed."""
        taken = True
        try:
            self.decoder.late(birth, layer, change)
        except CodecError:
            taken = False
        self.reader.late(birth, layer, change)
        self.check()
        if not taken:
            del self.reader.applied[birth].changes[layer]
        return taken

    def try_skip_map(self, birth: int, skip_map: bytes) -> bool:
        """Whether both accept `skip map` as the next; they must agree."""
        decoder = self.decoder
        wanted = self.reader.statuses(AppliedSlice(birth, skip_map, {}, {}))
        try:
            statuses = decode_skip_map(decoder.layout, birth, skip_map, decoder.history.of(birth))
        except CodecError:
            assert wanted is None
            return False
        assert wanted is not None
        assert statuses.tolist() == list(chain(*wanted))
        return True

    def try_slice(self, birth: int, skip_map: bytes, changes: Sequence[bytes | None]) -> bool:
        """Whether both accept the slice as the next; their states must then be equal. Both are left
        unchanged."""
        other = copy.copy(self)
        other.decoder, other.reader = copy.deepcopy((self.decoder, self.reader))
        fits = other._fits_plainly(birth, skip_map, changes)
        try:
            other.decoder.apply(birth, skip_map, changes)
        except CodecError:
            assert not fits
            return False
        assert fits
        other._apply_plainly(birth, skip_map, changes)
        other.check()
        return True

    def _apply_plainly(
        self, birth: int, skip_map: bytes | None, changes: Sequence[bytes | None]
    ) -> None:
        here = {layer: data for layer, data in enumerate(changes) if data is not None}
        self.reader.apply(birth, skip_map, here)

    def _fits_plainly(self, birth: int, skip_map: bytes, changes: Sequence[bytes | None]) -> bool:
        lane = self.reader.lanes[birth % self.reader.shape.swin_size]
        here = {layer: data for layer, data in enumerate(changes) if data is not None}
        slice_ = AppliedSlice(birth, skip_map, here, dict(enumerate(lane)))
        slice_.statuses = self.reader.statuses(slice_)
        if slice_.statuses is None:
            return False
        try:
            for layer in here:
                self.reader.changed(slice_, slice_.statuses[layer], layer)
        except AssertionError:
            return False
        return True


def try_keyframe(shape: plain.Shape, keyframe: bytes) -> bool:
    """Whether readers of both kinds accept `keyframe` as their first; their states must then be
    equal."""
    both = BothReaders(shape)
    both.reader.load(keyframe)
    known = any(slot is not plain.Hole.UNKNOWN for s in both.reader.lanes for r in s for slot in r)
    try:
        both.decoder.load(keyframe)
    except CodecError:
        assert not known
        return False
    assert known
    both.check()
    return True
