"""A passing slice: all that is different in one frame (codec/FORMAT.md, section 10.5).

It says what it changes in the slots as they are, shows in its frame alone, and leaves them as they
were: so it may be missing, and nothing becomes unknown.
"""

from __future__ import annotations

import struct
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import accumulate, pairwise

import numpy as np

from codec.coders.coder import EncodedChunk
from codec.errors import CodecError, CorruptError, InvalidError
from codec.lattice.lattice import Bytes, Flags, States
from codec.splats import Splats

from .mask import decode_mask
from .slotchange import decode_change, encoded_elsewhere
from .slotchunk import Kind, SlotHeader, with_birth
from .slotlayout import HEADER_BYTES, MAX_SLOT_CHUNK_BYTES, SlotLayout
from .slotstate import ESCAPED, Slots, holds
from .update import ENDED, KEPT, NEW, PREDICTED, Update

SIZE = struct.Struct("<I")


@dataclass(slots=True)
class Passing:
    """A passing slice, and what its frame shows."""

    birth: int
    statuses: list[Bytes]
    """The statuses of the slots, for each layer."""
    changes: list[memoryview] | None
    """The change of each layer that has slots; None if it only stands for a slice."""
    slots: list[Slots]
    """The slots that show, for each layer; the state itself where the slice changes nothing."""

    def show(self, layout: SlotLayout, layer: int, stays: Slots) -> None:
        """Takes what the slice makes of `stays`, the state of a layer. Raises a CodecError."""
        statuses = self.statuses[layer]
        self.slots[layer] = stays
        if self.changes is None or not statuses.any():
            return
        predicted = int(np.count_nonzero(statuses == PREDICTED))
        new = int(np.count_nonzero(statuses == NEW))
        change = decode_change(layout, layer, self.birth, self.changes[layer], predicted, new)
        delta = stays.delta(statuses, change)
        self.slots[layer] = stays.copy()
        self.slots[layer].advance(delta)


def encode_passing(
    layout: SlotLayout, mask: EncodedChunk, changes: Sequence[EncodedChunk]
) -> EncodedChunk:
    """The chunk of a passing slice, of no bytes if it changes nothing. changes: of the layers that
    have slots. Raises InvalidError if it becomes too large."""
    chunks = mask, *changes
    if not mask.data:
        return mask
    assert layout.temporal_layer is not None
    head = SlotHeader(Kind.PASSING, layout.temporal_layer, mask.birth).pack()
    head += b"".join(SIZE.pack(len(chunk.data)) for chunk in chunks)
    starts = accumulate((len(chunk.data) for chunk in chunks[:-1]), initial=len(head))
    edges = {0}.union(
        *(
            {start + edge for edge in chunk.edges}
            for start, chunk in zip(starts, chunks, strict=True)
        )
    )
    data = head + b"".join(chunk.data for chunk in chunks)
    if len(data) > MAX_SLOT_CHUNK_BYTES:
        raise InvalidError(
            f"passing: {len(data)} bytes, at most {MAX_SLOT_CHUNK_BYTES}; use fewer slots"
        )
    return EncodedChunk(mask.birth, data, sorted(edges))


def passing_elsewhere(layout: SlotLayout, data: bytes, birth: int) -> EncodedChunk:
    """The chunk in `data`, which can be decoded, to be compressed once more as that of `birth`."""
    assert layout.temporal_layer is not None

    def moved(kind: Kind, part: memoryview) -> EncodedChunk:
        if not part:
            return EncodedChunk(birth, b"", (0, 0))
        return encoded_elsewhere(layout, kind, with_birth(part, birth))

    mask, *changes = _split(layout.temporal_layer, memoryview(data))[1]
    moved_changes = tuple(moved(Kind.CHANGE, change) for change in changes)
    return encode_passing(layout, moved(Kind.MASK, mask), moved_changes)


def passing_statuses(layout: SlotLayout, birth: int, data: bytes, history: Bytes) -> Bytes:
    """(S,) the statuses in the chunk of a passing slice. history: `MaskHistory.of(birth)`. Raises a
    CodecError."""
    last = layout.temporal_layer
    assert last is not None
    if not data:
        return np.full(layout.num_slots, KEPT, np.uint8)
    SlotHeader.read(data, Kind.PASSING).expect(birth, last)
    return decode_mask(layout, birth, _split(last, memoryview(data))[1][0], history)


def _split(num_layers: int, data: memoryview) -> tuple[list[int], list[memoryview]]:
    """The edges of the mask and the `num_layers` changes in a chunk, and what they are. Raises
    CorruptError."""
    begin = HEADER_BYTES + SIZE.size * (1 + num_layers)
    if len(data) < begin:
        raise CorruptError(f"passing: {len(data)} bytes are too few for its sizes", len(data))
    sizes = (size for (size,) in SIZE.iter_unpack(data[HEADER_BYTES:begin]))
    edges = list(accumulate(sizes, initial=begin))
    if edges[-1] != len(data):
        raise CorruptError(f"passing: {len(data)} bytes, its sizes require {edges[-1]}")
    return edges, [data[first:end] for first, end in pairwise(edges)]


def decode_passing(
    layout: SlotLayout,
    birth: int,
    data: bytes | memoryview,
    history: Bytes,
    stay: Sequence[Slots],
) -> Passing | None:
    """The passing slice in `data` upon the slots `stay` of each layer; None without data. history:
    `MaskHistory.of(birth)`. Raises a CodecError."""
    if not data:
        return None
    last = layout.temporal_layer
    assert last is not None
    SlotHeader.read(data, Kind.PASSING).expect(birth, last)
    edges, (mask, *changes) = _split(last, memoryview(data))
    try:
        statuses = decode_mask(layout, birth, mask, history)
    except CodecError as error:
        raise error.moved(edges[0]) from error
    rows = layout.row_edges
    parts = [statuses[rows[n] : rows[n + 1]] for n in range(layout.num_layers)]
    passing = Passing(birth, parts, changes, list(stay))
    for layer in range(last):
        try:
            if changes[layer] and not parts[layer].any():
                raise CorruptError("passing: a change of a layer whose slots are all kept", 0)
            passing.show(layout, layer, stay[layer])
        except CodecError as error:
            raise error.moved(edges[1 + layer]) from error
    return passing


def composed(
    layout: SlotLayout, birth: int, before: Sequence[Slots], after: Sequence[Slots], renewed: Flags
) -> Update:
    """The update of a whole lane from the slots `before` to `after`, layer after layer.

    renewed: (S,) the slots that were ended, or given to another Gaussian, in between.
    """
    statuses = np.full(layout.num_slots, KEPT, np.uint8)
    states, escaped, escapes = [], [], []
    edges = layout.row_edges
    for layer, (old, new) in enumerate(zip(before, after, strict=True)):
        rows = slice(edges[layer], edges[layer + 1])
        had, has, fresh = holds(old.conditions), holds(new.conditions), renewed[rows]
        differs = old.states.differ(new.states)
        statuses[rows][had & ~has] = ENDED
        statuses[rows][has & differs] = PREDICTED
        statuses[rows][has & (fresh | ~had)] = NEW
        coded = np.flatnonzero(statuses[rows] >= PREDICTED)
        states.append(new.states.take(coded))
        escaped.append(new.conditions[coded] == ESCAPED)
        order = np.argsort(new.escape_rows)
        escapes.append(new.escapes.take(order[np.isin(new.escape_rows[order], coded)]))
    flags = np.concatenate(escaped)
    return Update(
        birth,
        statuses,
        States.concatenate(states),
        np.zeros(len(flags), np.uint8),
        flags,
        Splats.concatenate(escapes),
    )
