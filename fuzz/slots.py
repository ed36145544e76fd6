"""Targets for the parsers of chunks, with the property of fuzz/codec.py: skip maps, changes,
keyframes, and a reader that executes a script.

The first byte of the input chooses the layout (`LAYOUTS`).
"""

from __future__ import annotations

import struct

import numpy as np

from codec.errors import CodecError, CorruptError
from codec.lattice.lattice import Lattice, States
from codec.slots.change import decode_change, encode_change
from codec.slots.decoder import MIN_LOG_BYTES, SlotDecoder
from codec.slots.encoder import SlotEncoder
from codec.slots.skipmap import decode_skip_map, encode_skip_map
from codec.slots.slotlayout import HEADER_BYTES, SLOT_HEADER, Kind, SlotHeader, SlotLayout
from codec.slots.state import UNKNOWN, Slots, decode_keyframe, encode_keyframe

LATTICE = Lattice(0.01, 0.125, 1 / 60, 0.056, 41)
LAYOUTS = (
    SlotLayout(2, (5, 3), 0, (LATTICE,) * 2, 4),
    SlotLayout(1, (9,), 1, (Lattice(1e-6, 1e6, 1e6, 1e6, 256, -1e3),), 3),
    SlotLayout(3, (1, 4, 2), 0, (LATTICE,) * 3, 1),
)

LOAD, APPLY, LATE = range(3)
"""Operations of a script on a reader."""

STEP = struct.Struct("<BBBBH")
"""Head of a step: operation, missing parts, layer, age of the slice, and number of bytes that
follow."""

Step = tuple[int, int, int, int, bytes]
"""Operation, missing parts, layer, age of the slice, the bytes."""

PART = struct.Struct("<H")
"""Head of each part of a slice: its number of bytes."""


def state_bytes(slots: Slots) -> bytes:
    """The whole state of slots; independent of the order in which escapes are stored."""
    order = np.argsort(slots.escape_rows, kind="stable")
    arrays = (
        slots.conditions,
        slots.states.positions,
        slots.states.attributes,
        slots.starts,
        slots.escape_rows[order],
        *slots.escapes.take(order).arrays,
    )
    return b"".join(array.tobytes() for array in arrays)


def fuzz_skip_map(data: bytes) -> None:
    """A skip map, after one byte for each slot: its status in earlier skip maps."""
    layout, data = LAYOUTS[data[0] % len(LAYOUTS)], data[1:]
    said = data[: layout.num_slots].ljust(layout.num_slots, b"\0")
    history = np.frombuffer(said, np.uint8) & np.uint8(3)
    food = data[layout.num_slots :]
    birth = SLOT_HEADER.unpack_from(food)[-1] if len(food) >= HEADER_BYTES else 0
    statuses = decode_skip_map(layout, birth, food, history)
    assert len(food) <= layout.max_skip_map_bytes
    again = encode_skip_map(layout, birth, statuses, history).data
    assert (decode_skip_map(layout, birth, again, history) == statuses).all()


def fuzz_change(data: bytes) -> None:
    """A change; its own counts stand for those of a skip map, as far as there are slots."""
    layout, food = LAYOUTS[data[0] % len(LAYOUTS)], data[1:]
    header = SlotHeader.read(food, Kind.CHANGE)
    layer = header.layer % layout.num_layers
    predicted = new = 0
    if len(food) >= HEADER_BYTES + 8:
        predicted, new = struct.unpack_from("<II", food, HEADER_BYTES)
    predicted = min(predicted, layout.slots[layer])
    new = min(new, layout.slots[layer] - predicted)
    change = decode_change(layout, layer, header.birth, food, predicted, new)
    assert len(food) <= layout.max_change_bytes(layer)
    before = States.zeros(predicted, layout.sh_degree)
    try:
        moved = change.predict(before, np.ones(predicted, np.bool_))
    except CodecError:  # it may be valid with other states
        return
    encoded = encode_change(layer, header.birth, before, moved, change.new, change.start_offsets)
    again = decode_change(layout, layer, header.birth, encoded.data, predicted, new)
    known = np.arange(predicted) % 2 == 0
    assert again.predict(before, known).positions.tobytes() == (
        change.predict(before, known).positions.tobytes()
    )
    assert again.new.escaped.tobytes() == change.new.escaped.tobytes()
    assert (again.start_offsets == change.start_offsets).all()


def fuzz_keyframe(data: bytes) -> None:
    """A keyframe of any layer and segment."""
    layout, food = LAYOUTS[data[0] % len(LAYOUTS)], data[1:]
    keyframe = decode_keyframe(layout, food)
    assert len(food) <= layout.max_keyframe_bytes(keyframe.layer)
    encoded = encode_keyframe(layout, keyframe.layer, keyframe.frame, keyframe.lanes).data
    again = decode_keyframe(layout, encoded)
    # A start in the past is now 0, and the integers of an escape are zeros.
    assert encode_keyframe(layout, again.layer, again.frame, again.lanes).data == encoded
    for one, other in zip(keyframe.lanes, again.lanes, strict=True):
        assert (one.conditions == other.conditions).all()
        assert one.states.positions.tobytes() == other.states.positions.tobytes()


def fuzz_slots(data: bytes) -> None:
    """A reader that executes a script of STEPs. A refused step leaves it unchanged."""
    run_script(data)


def run_script(data: bytes) -> int:
    """Runs the script; returns the number of steps that the reader accepted."""
    layout = LAYOUTS[data[0] % len(LAYOUTS)]
    decoder, at, taken = SlotDecoder(layout), 1, 0
    while at + STEP.size <= len(data):
        what, missing, layer, age, size = STEP.unpack_from(data, at)
        food = data[at + STEP.size : at + STEP.size + size]
        at += STEP.size + size
        before, frame = _held(decoder), decoder.frame
        try:
            _step(decoder, what % 3, missing, layer, age, food)
            taken += 1
        except CodecError:
            assert (_held(decoder), decoder.frame) == (before, frame)
        _check(decoder)
    return taken


def _held(decoder: SlotDecoder) -> list[bytes]:
    return [state_bytes(slots) for lane in decoder.lanes for slots in lane]


def _step(decoder: SlotDecoder, what: int, missing: int, layer: int, age: int, food: bytes) -> None:
    frame = decoder.frame
    if what == LOAD:
        decoder.load(food)
    elif frame is None:
        raise CorruptError("no keyframe yet")
    elif what == LATE:
        decoder.late(frame - age, layer % decoder.num_layers, food)
    else:
        parts = _parts(food)[: decoder.num_layers + 1]
        given = [None if missing >> n & 1 else part for n, part in enumerate(parts)]
        decoder.apply(frame + 1, given[0] if given else None, given[1:])


def _parts(food: bytes) -> list[bytes]:
    """The parts of a slice: the skip map, then the change of each layer."""
    parts = []
    at = 0
    while at + PART.size <= len(food):
        (size,) = PART.unpack_from(food, at)
        parts.append(food[at + PART.size : at + PART.size + size])
        at += PART.size + size
    return parts


def _check(decoder: SlotDecoder) -> None:
    """The state can be shown, is bounded, and equals what a resumed writer would send."""
    if decoder.frame is None:
        return
    shown = decoder.window(decoder.frame)
    assert all(len(part.splats) == decoder.layout.num_slots for part in shown)
    assert decoder.log_bytes <= MIN_LOG_BYTES
    known = not any((slots.conditions == UNKNOWN).any() for lane in decoder.lanes for slots in lane)
    if known and decoder.frame == decoder.layout.segment_start(decoder.frame):
        other = SlotDecoder(decoder.layout)
        for chunk in SlotEncoder.resumed(decoder).keyframes():
            other.load(chunk.data)
        for mine, its in zip(
            decoder.window(decoder.frame), other.window(decoder.frame), strict=True
        ):
            for a, b in zip(mine.splats.arrays, its.splats.arrays, strict=True):
                assert a.tobytes() == b.tobytes()


def script(layout_number: int, steps: list[Step]) -> bytes:
    """An input of `fuzz_slots`."""
    made = bytes([layout_number])
    for *numbers, food in steps:
        made += STEP.pack(*numbers, len(food)) + food
    return made


def slice_food(parts: list[bytes]) -> bytes:
    """A slice in a script: its skip map and its changes."""
    return b"".join(PART.pack(len(part)) + part for part in parts)
