"""Seeds for the parsers of objects and chunks, from the project's own encoder."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np

from codec.coders.coder import EncodedChunk
from codec.lattice.lattice import States
from codec.slots.changepacket import CHECKSUM, encode_change_packet
from codec.slots.encoder import SlotEncoder
from codec.slots.slotlayout import NEW, PREDICTED, SlotLayout, Update
from codec.slots.state import ON_LATTICE
from codec.splats import Splats, array_shapes
from codec.stream.segment import SegmentRecord, encode_packet, join_packets, pack_record

from .slots import APPLY, LATE, LAYOUTS, LOAD, Step, script, slice_food

NUM_FRAMES = 6


def made_update(encoder: SlotEncoder, rng: np.random.Generator) -> Update:
    """A random valid update that `encoder` accepts next."""
    layout, birth = encoder.layout, encoder.next_birth
    lane = encoder.lanes[layout.lane(birth)]
    conditions = np.concatenate([slots.conditions for slots in lane])
    statuses = rng.integers(0, 4, layout.num_slots).astype(np.uint8)
    statuses[(statuses == PREDICTED) & (conditions != ON_LATTICE)] = NEW
    coded = np.flatnonzero(statuses >= PREDICTED)
    is_new, count = statuses[coded] == NEW, len(coded)
    levels = np.repeat([lattice.opacity_levels for lattice in layout.lattices], layout.slots)
    attributes = rng.integers(0, 256, (count, layout.num_planes - 3)).astype(np.uint8)
    attributes[:, -1] = rng.integers(0, levels[coded])
    escaped = is_new & (rng.random(count) < 0.3)
    shapes = array_shapes(int(escaped.sum()), layout.sh_degree)
    offsets = rng.integers(0, layout.swin_size, count) * is_new
    return Update(
        birth,
        statuses,
        States(rng.integers(-400, 400, (count, 3)).astype(np.int32), attributes),
        offsets.astype(np.uint8),
        escaped,
        Splats(*(rng.normal(size=shape).astype(np.float32) + 9 for shape in shapes)),
    )


def made_chunks(
    layout: SlotLayout,
) -> tuple[list[EncodedChunk], list[list[EncodedChunk]], dict[int, list[EncodedChunk]]]:
    """The skip maps, the changes of each layer, and the keyframes by frame, of a stream."""
    encoder, rng = SlotEncoder(layout), np.random.default_rng(layout.num_slots)
    skip_maps: list[EncodedChunk] = []
    changes: list[list[EncodedChunk]] = []
    keyframes: dict[int, list[EncodedChunk]] = {}
    while encoder.next_birth < NUM_FRAMES:
        encoded = encoder.append(made_update(encoder, rng))
        if encoded is None:
            continue
        skip_maps.append(encoded.skip_map)
        changes.append(list(encoded.changes))
        if encoded.birth == layout.segment_start(encoded.birth):
            keyframes[encoded.birth] = list(encoder.keyframes())
    return skip_maps, changes, keyframes


def _scripts(number: int) -> Iterator[tuple[str, bytes]]:
    """Scripts for a reader: one complete, and one with missing, late and repeated parts."""
    skip_maps, changes, keyframes = made_chunks(LAYOUTS[number])
    loads: list[Step] = [(LOAD, 0, 0, 0, chunk.data) for chunk in keyframes[0]]
    slices = [
        slice_food([skip_map.data, *(change.data for change in of_layers)])
        for skip_map, of_layers in zip(skip_maps, changes, strict=True)
    ]
    whole = [*loads, *((APPLY, 0, 0, 0, food) for food in slices[1:])]
    yield f"whole-{number}", script(number, whole)
    torn = list(loads)
    for birth, food in enumerate(slices[1:], start=1):
        torn.append((APPLY, 2 if birth < 4 else 1, 0, 0, food))  # the first change, or the skip map
        torn += [(LOAD, 0, 0, 0, chunk.data) for chunk in keyframes.get(birth, [])]
        if birth == 3:
            torn += [(LATE, 0, 0, 3 - b, changes[b][0].data) for b in (2, 1, 3, 3)]
    yield f"torn-{number}", script(number, torn)


def made_index() -> bytes:
    """Two records of two layers, after the byte that gives the number of layers."""
    hashes = bytes(32), b"\1" * 32, b"\2" * 32
    records = [
        SegmentRecord(n, 4 * n, 4 - n, (9, 7), hashes[:2], (30.5, math.nan), (5, 4, 3), hashes)
        for n in range(2)
    ]
    return b"\1" + b"".join(map(pack_record, records))


def slot_seeds() -> Iterator[tuple[str, str, bytes]]:
    """(target, name, input), as in fuzz/seed.py."""
    for number, layout in enumerate(LAYOUTS):
        skip_maps, changes, keyframes = made_chunks(layout)
        head = bytes([number])
        # The second skip map of a segment is read as if it were the first.
        history = bytes(layout.num_slots)
        first = 1 if layout.segment_frames > 1 else 0
        yield "skip_map", str(number), head + history + skip_maps[first].data
        told = [change.data for of_layers in changes for change in of_layers if change.data]
        yield "change", str(number), head + told[-1]
        last = keyframes[max(keyframes)]
        yield "keyframe", str(number), head + last[0].data
        for what, food in _scripts(number):
            yield "slots", what, food
        packets = [(skip_map.birth, encode_packet(skip_map)) for skip_map in skip_maps]
        yield "object", str(number), join_packets(packets)
        yield "packet", str(number), packets[-1][1]
        coded = encode_change_packet(told[-1], layout.sh_degree)
        yield "coded_change", str(number), coded[1 : -CHECKSUM.size]
    yield "index", "two", made_index()
    yield "sealed_index", "two", made_index()
