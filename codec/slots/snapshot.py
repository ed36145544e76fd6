"""A snapshot: all slots of one layer at a segment's first frame (codec/FORMAT.md, section 11)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from codec.coders.coder import EncodedChunk
from codec.errors import CodecError, CorruptError, InvalidError
from codec.lattice.lattice import States
from codec.slice import window_births
from codec.splats import Splats

from .slotchange import Newcomers, encode_body, finish_chunk, read_body
from .slotchunk import BIRTH_AT, LAYER_AT, Kind, SlotHeader
from .slotlayout import HEADER_BYTES, SlotLayout
from .slotstate import EMPTY, ESCAPED, ON_LATTICE, UNKNOWN, Slots, holds


@dataclass(frozen=True, slots=True)
class Snapshot:
    """A snapshot, decoded."""

    frame: int
    layer: int
    lanes: tuple[Slots, ...]
    """The slots in the lanes of the births frame - swin_size + 1 .. frame."""


def encode_snapshot(
    layout: SlotLayout, layer: int, frame: int, lanes: Sequence[Slots]
) -> EncodedChunk:
    """The snapshot of `layer` whose slots, oldest lane first, are `lanes`."""
    parts, offsets, present = [], [], []
    for birth, slots in zip(window_births(frame, layout.swin_size), lanes, strict=True):
        if (slots.conditions == UNKNOWN).any():
            raise InvalidError(f"snapshot: slots of layer {layer} are unknown in frame {frame}")
        here = holds(slots.conditions)
        starts = slots.starts[here]
        parts.append(slots.newcomers())
        present.append(here)
        # A start that has passed is all the same.
        offsets.append(np.where(starts > frame - birth, starts, 0).astype(np.uint8))
    new = Newcomers(
        States.concatenate([part.states for part in parts]),
        np.concatenate([part.escaped for part in parts]),
        Splats.concatenate([part.escapes for part in parts]),
    )
    none = States.zeros(0, layout.sh_degree)
    start_offsets = np.concatenate(offsets)
    has_offsets = bool(start_offsets.any())
    body, edges = encode_body(none, none, new, start_offsets if has_offsets else None)
    flags = np.packbits(np.concatenate(present), bitorder="little").tobytes()
    header = SlotHeader(Kind.SNAPSHOT, layer, frame, has_offsets)
    return finish_chunk(header, flags, body, edges)


def decode_snapshot(layout: SlotLayout, data: bytes | memoryview) -> Snapshot:
    """The snapshot in `data`, of any layer and segment. Raises a CodecError."""
    header = SlotHeader.read(data, Kind.SNAPSHOT)
    if header.layer >= layout.num_layers:
        raise CorruptError(
            f"snapshot: layer {header.layer} of {layout.num_layers} layers", LAYER_AT
        )
    if header.birth < 0 or header.birth != layout.segment_start(header.birth):
        raise CorruptError(
            f"snapshot: frame {header.birth} is not the first of a segment of "
            f"{layout.segment_frames}",
            BIRTH_AT,
        )
    count = layout.slots[header.layer]
    size = layout.flags_bytes(header.layer)
    if len(data) < HEADER_BYTES + size:
        raise CorruptError("snapshot: too short for its flags", len(data))
    bits = np.unpackbits(np.frombuffer(data, np.uint8, size, HEADER_BYTES), bitorder="little").view(
        np.bool_
    )
    if bits[layout.swin_size * count :].any():
        raise CorruptError("snapshot: a bit is set after the last flag", HEADER_BYTES + size - 1)
    present = bits[: layout.swin_size * count]
    begin = HEADER_BYTES + size
    try:
        read = read_body(
            layout,
            header.layer,
            memoryview(data)[begin:],
            0,
            int(np.count_nonzero(present)),
            header.has_start_offsets,
        )
    except CodecError as error:
        raise error.moved(begin) from error
    new, at, escape_at = read.new, 0, 0
    lanes = []
    for here in present.reshape(layout.swin_size, count):
        slots = Slots(count, layout.sh_degree, EMPTY)
        rows = np.flatnonzero(here)
        part = slice(at, at + len(rows))
        at += len(rows)
        escaped = new.escaped[part]
        slots.conditions[rows] = np.where(escaped, ESCAPED, ON_LATTICE)
        slots.starts[rows] = read.start_offsets[part]
        inside = rows[~escaped]
        slots.states.put(inside, new.states.take(part).take(~escaped))
        slots.escape_rows = rows[escaped]
        num_escaped = len(slots.escape_rows)
        slots.escapes = new.escapes.take(slice(escape_at, escape_at + num_escaped))
        escape_at += num_escaped
        lanes.append(slots)
    return Snapshot(header.birth, header.layer, tuple(lanes))
