"""The states of slots, in a reader or a writer, before a slice changes them and after it
(codec/FORMAT.md, section 7); and a keyframe, all slots of a layer at a segment's first frame
(section 11).

Rule: what a change would make is found out first, as a `Delta`; so bytes that break a rule leave
everything as it was.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from codec.arrays import Bytes, Flags, Floats, Ints, Longs
from codec.coders.coder import EncodedChunk
from codec.errors import CodecError, CorruptError, InvalidError
from codec.lattice.forms import opacity_logits
from codec.lattice.lattice import Lattice, States, dequantise_into
from codec.slice import HIDDEN, Motion, Slice, window_births
from codec.splats import Splats, array_shapes

from .change import Change, Newcomers, encode_body, finish_chunk, read_body
from .slotlayout import (
    BIRTH_AT,
    ENDED,
    HEADER_BYTES,
    LAYER_AT,
    NEW,
    PREDICTED,
    Kind,
    SlotHeader,
    SlotLayout,
)

UNKNOWN, EMPTY, ON_LATTICE, ESCAPED = 0, 1, 2, 3
"""The condition of a slot: what it held is lost, nothing, or a Gaussian of one of two kinds."""


def holds(conditions: Bytes) -> Flags:
    """Where there is a Gaussian."""
    return conditions >= ON_LATTICE


@dataclass(frozen=True, slots=True)
class Delta:
    """Changes to some slots."""

    rows: Longs  # (D,) the slots, in any order
    conditions: Bytes  # (D,)
    states: States  # (D); zeros where none is on the lattice
    starts: Bytes  # (D,) frames after the birth of the slice; HIDDEN where there is no Gaussian
    escape_rows: Longs  # (E,) those of `rows` that escaped
    escapes: Splats  # (E)


class Slots:
    """The slots of one layer in one lane, as integers."""

    def __init__(self, count: int, sh_degree: int, condition: int) -> None:
        self.conditions = np.full(count, condition, np.uint8)
        self.states = States.zeros(count, sh_degree)
        """Zeros where no Gaussian is on the lattice."""
        self.starts = np.full(count, HIDDEN, np.uint8)
        """(count,) frames after the birth of the lane's slice; HIDDEN where no Gaussian is."""
        self.escape_rows: Longs = np.zeros(0, np.int64)
        """The slots of `escapes`."""
        self.escapes = Splats.empty(sh_degree)

    def __len__(self) -> int:
        return len(self.conditions)

    @property
    def has_unknown(self) -> bool:
        """Whether any slot is unknown."""
        return bool((self.conditions == UNKNOWN).any())

    @property
    def num_bytes(self) -> int:
        """Size of the slots in memory."""
        arrays = self.conditions, *(self.states.positions, self.states.attributes), self.starts
        return sum(array.nbytes for array in arrays) + self.escapes.num_bytes

    def copy(self) -> Slots:
        made = Slots(0, self.states.sh_degree, UNKNOWN)
        made.conditions = self.conditions.copy()
        made.states = self.states.copy()
        made.starts = self.starts.copy()
        # Never altered, only replaced.
        made.escape_rows, made.escapes = self.escape_rows, self.escapes
        return made

    def rearranged(self, rows: Longs) -> Slots:
        """The slots at `rows`, a permutation of all."""
        made = Slots(0, self.states.sh_degree, UNKNOWN)
        made.conditions, made.starts = self.conditions[rows], self.starts[rows]
        made.states, made.escapes = self.states.take(rows), self.escapes
        made.escape_rows = np.argsort(rows)[self.escape_rows]
        return made

    def delta(self, statuses: Bytes, change: Change | None) -> Delta:
        """Changes by a slice with these (count,) `statuses`; change: None if it is not at hand.
        Raises CorruptError if it does not fit what is here."""
        predicted = np.flatnonzero(statuses == PREDICTED)
        new = np.flatnonzero(statuses == NEW)
        ended = np.flatnonzero(statuses == ENDED)
        rows = np.concatenate([predicted, new, ended])
        conditions = np.empty(len(rows), np.uint8)
        starts = np.full(len(rows), HIDDEN, np.uint8)
        coded = len(predicted) + len(new)
        conditions[coded:] = EMPTY
        nothing = States.zeros(len(ended), self.states.sh_degree)
        if change is None:
            conditions[:coded] = UNKNOWN
            states = States.zeros(len(rows), self.states.sh_degree)
            no_rows = np.zeros(0, np.int64)
            return Delta(rows, conditions, states, starts, no_rows, Splats.empty(states.sh_degree))
        before = self.conditions[predicted]
        for condition, name in ((EMPTY, "is empty"), (ESCAPED, "has escaped")):
            if (before == condition).any():
                slot = predicted[np.argmax(before == condition)]
                raise CorruptError(f"change: slot {slot} is predicted, but it {name}")
        known = before == ON_LATTICE
        moved = change.predict(self.states.take(predicted), known)
        conditions[: len(predicted)] = before  # what was unknown stays so
        escaped = change.new.escaped
        conditions[len(predicted) : coded] = np.where(escaped, ESCAPED, ON_LATTICE)
        starts[: len(predicted)][known] = 0
        starts[len(predicted) : coded] = change.start_offsets
        states = States.concatenate([moved, _without(change.new), nothing])
        return Delta(rows, conditions, states, starts, new[escaped], change.new.escapes)

    def put(self, delta: Delta) -> None:
        """Takes in what a slice makes of these slots."""
        rows = delta.rows
        if len(self.escape_rows):
            touched = np.zeros(len(self), np.bool_)
            touched[rows] = True
            stay = np.flatnonzero(~touched[self.escape_rows])
            self.escape_rows, self.escapes = self.escape_rows[stay], self.escapes.take(stay)
        if len(delta.escape_rows):
            self.escape_rows = np.concatenate([self.escape_rows, delta.escape_rows])
            self.escapes = Splats.concatenate([self.escapes, delta.escapes])
        self.conditions[rows] = delta.conditions
        self.starts[rows] = delta.starts
        self.states.put(rows, delta.states)

    def advance(self, delta: Delta) -> None:
        """Goes on by one slice: what is kept has started by now."""
        self.starts[holds(self.conditions)] = 0
        self.put(delta)

    def newcomers(self) -> Newcomers:
        """All Gaussians that are here, as ones that are coded by themselves."""
        here = np.flatnonzero(holds(self.conditions))
        order = np.argsort(self.escape_rows, kind="stable")
        return Newcomers(
            self.states.take(here), self.conditions[here] == ESCAPED, self.escapes.take(order)
        )

    def draw(self, rows: Longs, lattice: Lattice, arrays: tuple[Floats, ...]) -> None:
        """Fills the arrays of a `Splats` with what the slots `rows` hold; where that is nothing
        with zeros and the quaternion (1, 0, 0, 0)."""
        states = self.states.take(rows)
        logits = opacity_logits(lattice.opacity_levels)
        with np.errstate(over="ignore", invalid="ignore"):
            dequantise_into(states.positions, states.attributes, lattice.floats(), logits, *arrays)
        arrays[3][~holds(self.conditions[rows])] = 0
        if len(self.escape_rows):
            place_of = np.full(len(self), -1, np.int64)
            place_of[self.escape_rows] = np.arange(len(self.escape_rows))
            places = place_of[rows]
            escaped = places >= 0
            for array, source in zip(arrays, self.escapes.arrays, strict=True):
                array[escaped] = source[places[escaped]]


def _without(new: Newcomers) -> States:
    """The states of `new`, zeros for what escaped."""
    if new.escaped.any():
        escaped = np.flatnonzero(new.escaped)
        new.states.put(escaped, States.zeros(len(escaped), new.states.sh_degree))
    return new.states


def empty_arrays(count: int, sh_degree: int) -> tuple[Floats, ...]:
    """Room for the arrays of `count` Gaussians."""
    return tuple(np.empty(shape, np.float32) for shape in array_shapes(count, sh_degree))


@dataclass(frozen=True, slots=True)
class HeldSlots:
    """M slots of a lane before a slice that changes them."""

    rows: Ints  # (M,) rising, counted over all layers
    splats: Splats  # M
    here: Flags  # (M,) where there is a Gaussian
    renewed: Flags  # (M,) those that the slice does not predict

    def with_motion(self, changed: Slice) -> Slice:
        """`changed`, with the motion of these rows. Gaussians that start later do not show yet."""
        assert changed.rows is not None
        places = np.searchsorted(changed.rows, self.rows)
        is_here = changed.start_offsets[places] == 0
        motion = Motion.of(
            self.rows, self.splats, self.here, changed.splats.take(places), is_here, self.renewed
        )
        return replace(changed, motion=motion)


@dataclass(frozen=True, slots=True)
class Keyframe:
    """A keyframe, decoded."""

    frame: int
    layer: int
    lanes: tuple[Slots, ...]
    """The slots in the lanes of the births frame - swin_size + 1 .. frame."""


def encode_keyframe(
    layout: SlotLayout, layer: int, frame: int, lanes: Sequence[Slots]
) -> EncodedChunk:
    """The keyframe of `layer` whose slots, oldest lane first, are `lanes`."""
    parts, offsets, present = [], [], []
    for birth, slots in zip(window_births(frame, layout.swin_size), lanes, strict=True):
        if (slots.conditions == UNKNOWN).any():
            raise InvalidError(f"keyframe: slots of layer {layer} are unknown in frame {frame}")
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
    header = SlotHeader(Kind.KEYFRAME, layer, frame, has_offsets)
    return finish_chunk(header, flags, body, edges)


def decode_keyframe(layout: SlotLayout, data: bytes | memoryview) -> Keyframe:
    """The keyframe in `data`, of any layer and segment. Raises a CodecError."""
    header = SlotHeader.read(data, Kind.KEYFRAME)
    if header.layer >= layout.num_layers:
        raise CorruptError(
            f"keyframe: layer {header.layer} of {layout.num_layers} layers", LAYER_AT
        )
    if header.birth < 0 or header.birth != layout.segment_start(header.birth):
        raise CorruptError(
            f"keyframe: frame {header.birth} is not the first of a segment of "
            f"{layout.segment_frames}",
            BIRTH_AT,
        )
    count = layout.slots[header.layer]
    size = layout.flags_bytes(header.layer)
    if len(data) < HEADER_BYTES + size:
        raise CorruptError("keyframe: too short for its flags", len(data))
    bits = np.unpackbits(np.frombuffer(data, np.uint8, size, HEADER_BYTES), bitorder="little").view(
        np.bool_
    )
    if bits[layout.swin_size * count :].any():
        raise CorruptError("keyframe: a bit is set after the last flag", HEADER_BYTES + size - 1)
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
    return Keyframe(header.birth, header.layer, tuple(lanes))
