"""Changes: what a slice brings to one layer, as byte planes (codec/FORMAT.md, section 10).
Predicted Gaussians are differences to what their slots held, new ones follow one another.

Rule: nothing is allocated before the counts in the bytes are those that the skip map says, and no
state is touched: a `Change` is what the bytes say, and `Slots` says what becomes of it.
"""

from __future__ import annotations

import struct
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from itertools import accumulate

import numpy as np

from codec.arrays import Bytes, Flags, Ints
from codec.coders.coder import EncodedChunk
from codec.coders.planes import append_bits
from codec.errors import CodecError, CorruptError, InvalidError
from codec.kernel import kernel
from codec.lattice.lattice import (
    POSITION_LIMIT,
    States,
    bytes_per_gaussian,
    num_attributes,
    pack_arrays,
    read_arrays,
)
from codec.splats import Splats

from .slotlayout import (
    COUNTS_BYTES,
    HEADER_BYTES,
    MAX_SLOT_CHUNK_BYTES,
    Kind,
    SlotHeader,
    SlotLayout,
)

LONG = 255
"""The byte of a difference that stands among the long residuals."""

MAX_LENGTH = 25
"""Bit length of the zigzag of the longest difference of two positions on the lattice."""

SPARE_BYTES = 4
"""Behind the low bits, so that a run of them is read without looking at the end."""


def encode_predicted(before: States, predicted: States) -> tuple[Bytes, Ints]:
    """(3 + A, P) planes of the differences, and those that a byte does not hold."""
    count = len(predicted)
    planes = np.empty((3 + predicted.attributes.shape[1], count), np.uint8)
    longs = np.empty(3 * count, np.int32)
    used = _encode_predicted(
        before.positions,
        before.attributes,
        predicted.positions,
        predicted.attributes,
        planes,
        longs,
    )
    return planes, longs[:used]


def decode_predicted(
    planes: Bytes, longs: Ints, before: States, known: Flags, opacity_levels: int
) -> States:
    """The states that `encode_predicted` took apart; zeros where `before` is not known.

    Raises CorruptError for a wrong number of long residuals and for what leaves the lattice.
    """
    wanted = int(np.count_nonzero(planes[:3] == LONG))
    if wanted != len(longs):
        raise CorruptError(f"change: {len(longs)} long residuals where {wanted} belong")
    made = States(np.empty_like(before.positions), np.empty_like(before.attributes))
    wrong = _decode_predicted(
        planes,
        longs,
        before.positions,
        before.attributes,
        known,
        opacity_levels,
        made.positions,
        made.attributes,
    )
    if wrong >= 0:
        raise CorruptError(f"change: predicted Gaussian {wrong} leaves the lattice")
    return made


def encode_new(new: States, escaped: Flags) -> tuple[Bytes, bytes]:
    """(3 + A, N) planes of Gaussians, and the low bits of their positions. One that escapes takes
    the position of the one before it, and bytes of zero."""
    planes = np.empty((3 + new.attributes.shape[1], len(new)), np.uint8)
    packed = np.zeros((3 * (MAX_LENGTH - 1) * len(new) + 7) // 8 + 1, np.uint8)
    num_bits = _encode_new(new.positions, new.attributes, escaped, planes, packed)
    return planes, packed[: (num_bits + 7) // 8].tobytes()


def decode_new(
    planes: Bytes, low_bits: bytes | memoryview, sh_degree: int, opacity_levels: int
) -> States:
    """The states that `encode_new` took apart.

    Raises CorruptError for a wrong amount of bits, a bit set behind them, and for what is not on
    the lattice.
    """
    count = planes.shape[1]
    lengths = planes[:3]
    if count and lengths.max() > MAX_LENGTH:
        raise CorruptError(f"change: a difference of {lengths.max()} bits, at most {MAX_LENGTH}")
    if count and planes[-1].max() >= opacity_levels:
        raise CorruptError(f"change: opacity {planes[-1].max()} of {opacity_levels} levels")
    num_bits = int(lengths.sum(dtype=np.int64)) - int(np.count_nonzero(lengths))
    if len(low_bits) != (num_bits + 7) // 8:
        raise CorruptError(f"change: {len(low_bits)} bytes of low bits, not {num_bits} bits")
    packed = np.zeros(len(low_bits) + SPARE_BYTES, np.uint8)
    packed[: len(low_bits)] = np.frombuffer(low_bits, np.uint8)
    if num_bits % 8 and packed[len(low_bits) - 1] >> (num_bits % 8):
        raise CorruptError(f"change: a bit is set after the {num_bits} low bits")
    made = States(
        np.empty((count, 3), np.int32), np.empty((count, num_attributes(sh_degree)), np.uint8)
    )
    wrong = _decode_new(planes, packed, made.positions, made.attributes)
    if wrong >= 0:
        raise CorruptError(f"change: new Gaussian {wrong} leaves the lattice")
    return made


@kernel(nogil=True)
def _zigzag(value):  # type: ignore[no-untyped-def]
    return 2 * value if value >= 0 else -2 * value - 1


@kernel(nogil=True)
def _unzigzag(value):  # type: ignore[no-untyped-def]
    return (value >> 1) ^ -(value & 1)


@kernel(nogil=True)
def _encode_predicted(  # type: ignore[no-untyped-def]
    old_positions, old_attributes, positions, attributes, planes, longs
):
    """Fills planes and longs; gives how many are long."""
    used = 0
    for axis in range(3):
        for i in range(positions.shape[0]):
            difference = np.int64(positions[i, axis]) - np.int64(old_positions[i, axis])
            value = _zigzag(difference)
            if value < LONG:
                planes[axis, i] = value
            else:
                planes[axis, i] = LONG
                longs[used] = difference
                used += 1
    for i in range(attributes.shape[0]):
        for a in range(attributes.shape[1]):
            step = (np.int64(attributes[i, a]) - np.int64(old_attributes[i, a])) & 255
            planes[3 + a, i] = _zigzag(step - 256 if step > 127 else step)
    return used


@kernel(nogil=True)
def _decode_predicted(  # type: ignore[no-untyped-def]
    planes, longs, old_positions, old_attributes, known, levels, positions, attributes
):
    """Fills the last two; gives the first that leaves the lattice, or -1."""
    limit, last = POSITION_LIMIT, attributes.shape[1] - 1
    used = 0
    wrong = -1
    for axis in range(3):
        for i in range(positions.shape[0]):
            difference = _unzigzag(np.int64(planes[axis, i]))
            if planes[axis, i] == LONG:
                difference = np.int64(longs[used])
                used += 1
            if known[i]:
                place = np.int64(old_positions[i, axis]) + difference
                if place <= -limit or place >= limit:
                    wrong = i
                    place = 0
                positions[i, axis] = place
            else:
                positions[i, axis] = 0
    for i in range(attributes.shape[0]):
        if not known[i]:
            for a in range(last + 1):
                attributes[i, a] = 0
            continue
        for a in range(last + 1):
            step = _unzigzag(np.int64(planes[3 + a, i]))
            attributes[i, a] = (np.int64(old_attributes[i, a]) + step) & 255
        if attributes[i, last] >= levels:
            wrong = i
    return wrong


@kernel(nogil=True)
def _encode_new(positions, attributes, escaped, planes, packed):  # type: ignore[no-untyped-def]
    """Fills planes and packed, which begins as zeros; gives the number of low bits."""
    last = attributes.shape[1] - 1
    before = np.zeros(3, np.int64)
    bit = 0
    for i in range(positions.shape[0]):
        if escaped[i]:
            for plane in range(planes.shape[0]):
                planes[plane, i] = 0
            continue
        for axis in range(3):
            place = np.int64(positions[i, axis])
            value = _zigzag(place - before[axis])
            before[axis] = place
            length = 0
            while value >> length:
                length += 1
            planes[axis, i] = length
            bit = append_bits(packed, bit, value, length - 1)
        for a in range(last):
            planes[3 + a, i] = attributes[i, a] ^ 128
        planes[3 + last, i] = attributes[i, last]
    return bit


@kernel(nogil=True)
def _decode_new(planes, packed, positions, attributes):  # type: ignore[no-untyped-def]
    """Fills the last two; gives the first that leaves the lattice, or -1. packed: the low bits and
    SPARE_BYTES more."""
    limit, last = POSITION_LIMIT, attributes.shape[1] - 1
    before = np.zeros(3, np.int64)
    bit = np.int64(0)
    for i in range(positions.shape[0]):
        for axis in range(3):
            length = np.int64(planes[axis, i])
            if length > 0:
                first = bit >> 3
                word = np.int64(0)
                for byte in range(4):
                    word |= np.int64(packed[first + byte]) << (8 * byte)
                leading = 1 << (length - 1)
                value = leading | ((word >> (bit & 7)) & (leading - 1))
                bit += length - 1
                before[axis] += _unzigzag(value)
            if before[axis] <= -limit or before[axis] >= limit:
                return i
            positions[i, axis] = before[axis]
    for i in range(attributes.shape[0]):
        for a in range(last):
            attributes[i, a] = planes[3 + a, i] ^ 128
        attributes[i, last] = planes[3 + last, i]
    return -1


# predicted, new, long residuals, escapes, bytes of low bits
COUNTS = struct.Struct("<5I")
assert COUNTS.size == COUNTS_BYTES

INT32 = np.dtype("<i4")
UINT32 = np.dtype("<u4")


@dataclass(frozen=True, slots=True)
class Newcomers:
    """N Gaussians that are coded by themselves."""

    states: States  # N; those of the escaped mean nothing
    escaped: Flags  # (N,)
    escapes: Splats  # of the escaped, in order

    def __len__(self) -> int:
        return len(self.states)


@dataclass(frozen=True, slots=True)
class Change:
    """A change as its bytes say, of P predicted and N new Gaussians."""

    residuals: Bytes  # (3 + A, P)
    long_residuals: Ints  # (V,)
    new: Newcomers
    start_offsets: Bytes  # (N,) of the new, frames after birth
    opacity_levels: int

    def predict(self, before: States, known: Flags) -> States:
        """The P predicted, which were `before`; zeros where that is not known. Raises
        CorruptError."""
        return decode_predicted(
            self.residuals, self.long_residuals, before, known, self.opacity_levels
        )


def encode_body(
    before: States, predicted: States, new: Newcomers, start_offsets: Bytes | None
) -> tuple[bytes, list[int]]:
    """The body of a change, and the offsets between its parts. `before`: what the predicted were;
    start_offsets: of the new; None if all are 0."""
    residuals, longs = encode_predicted(before, predicted)
    planes, low_bits = encode_new(new.states, new.escaped)
    numbers = np.flatnonzero(new.escaped)
    counts = len(predicted), len(new), len(longs), len(numbers), len(low_bits)
    parts = [
        COUNTS.pack(*counts),
        *(plane.tobytes() for plane in residuals),
        longs.astype(INT32).tobytes(),
        *(plane.tobytes() for plane in planes),
        low_bits,
        numbers.astype(UINT32).tobytes(),
        pack_arrays(new.escapes),
        b"" if start_offsets is None else start_offsets.tobytes(),
    ]
    return b"".join(parts), [0, *accumulate(map(len, parts))]


def finish_chunk(
    header: SlotHeader, first: bytes, body: bytes, body_edges: Sequence[int]
) -> EncodedChunk:
    """The chunk of `first` and a change's body behind its header. Raises InvalidError if no reader
    would take it."""
    data = header.pack() + first + body
    if len(data) > MAX_SLOT_CHUNK_BYTES:
        raise InvalidError(
            f"{header.name}: {len(data)} bytes, at most {MAX_SLOT_CHUNK_BYTES}; use fewer slots"
        )
    return EncodedChunk(header.birth, data, _chunk_edges(len(first), body_edges))


def _chunk_edges(first_bytes: int, body_edges: Iterable[int]) -> list[int]:
    """The edges of a chunk with `first_bytes` between its header and its body."""
    begin = HEADER_BYTES + first_bytes
    # The bytes before the first plane are one part, or two if there is something first.
    inner = {begin + edge for edge in body_edges} - {begin}
    return sorted({0, *({begin} if first_bytes else ()), *inner})


def encoded_elsewhere(layout: SlotLayout, kind: Kind, data: bytes) -> EncodedChunk:
    """The chunk of `kind` in `data`, which can be decoded, to be compressed once more."""
    header = SlotHeader.read(data, kind)
    if kind is Kind.SKIP_MAP:
        return EncodedChunk(header.birth, data, (0, len(data)))
    first_bytes = layout.flags_bytes(header.layer) if kind is Kind.KEYFRAME else 0
    counts = COUNTS.unpack_from(data, HEADER_BYTES + first_bytes)
    head, predicted, longs, new, *rest = _part_sizes(layout, counts, header.has_start_offsets)
    planes = layout.num_planes
    sizes = head, *[predicted // planes] * planes, longs, *[new // planes] * planes, *rest
    edges = _chunk_edges(first_bytes, accumulate(sizes))
    return EncodedChunk(header.birth, data, edges, None if first_bytes else layout.sh_degree)


def encode_change(
    layer: int,
    birth: int,
    before: States,
    predicted: States,
    new: Newcomers,
    start_offsets: Bytes,
) -> EncodedChunk:
    """The change of `layer` that the slice born at `birth` brings, of no bytes if it brings
    nothing; see `encode_body`."""
    if not len(predicted) and not len(new):
        return EncodedChunk(birth, b"", (0, 0))
    offsets = start_offsets if start_offsets.any() else None
    body, edges = encode_body(before, predicted, new, offsets)
    header = SlotHeader(Kind.CHANGE, layer, birth, offsets is not None)
    return replace(finish_chunk(header, b"", body, edges), sh_degree=predicted.sh_degree)


def decode_change(
    layout: SlotLayout,
    layer: int,
    birth: int,
    data: bytes | memoryview,
    num_predicted: int,
    num_new: int,
) -> Change:
    """The change in `data`, whose counts are those of the skip map; without data it brings nothing.
    Raises a CodecError."""
    if not data:
        return _nothing(layout, layer, num_predicted, num_new)
    header = SlotHeader.read(data, Kind.CHANGE)
    header.expect(birth, layer)
    body = memoryview(data)[HEADER_BYTES:]
    try:
        return read_body(layout, layer, body, num_predicted, num_new, header.has_start_offsets)
    except CodecError as error:
        raise error.moved(HEADER_BYTES) from error


def _nothing(layout: SlotLayout, layer: int, num_predicted: int, num_new: int) -> Change:
    """The change that has no packet."""
    if num_predicted or num_new:
        raise CorruptError(
            "change: it is missing, but the skip map declares "
            f"{num_predicted} predicted, {num_new} new"
        )
    return read_body(layout, layer, memoryview(bytes(COUNTS.size)), 0, 0, False)


def read_body(
    layout: SlotLayout,
    layer: int,
    body: memoryview,
    num_predicted: int,
    num_new: int,
    has_start_offsets: bool,
) -> Change:
    """The change whose bytes behind the header are `body`. Raises CorruptError with its place in
    the body."""
    if len(body) < COUNTS.size:
        raise CorruptError(f"change: {len(body)} bytes are too few for its counts", len(body))
    counts = COUNTS.unpack_from(body)
    predicted, new = counts[:2]
    limits = num_predicted, num_new, 3 * num_predicted, num_new
    names = "predicted", "new", "long residuals", "escapes"
    for n, (name, found, limit) in enumerate(zip(names, counts, limits, strict=False)):
        if found > limit or (n < 2 and found != limit):
            rule = "the skip map declares" if n < 2 else "at most"
            raise CorruptError(f"change: {found} {name}, {rule} {limit}", 4 * n)
    levels, sh_degree = layout.lattices[layer].opacity_levels, layout.sh_degree
    sizes = _part_sizes(layout, counts, has_start_offsets)
    ends = list(accumulate(sizes))
    if ends[-1] != len(body):
        raise CorruptError(f"change: a body of {len(body)} bytes, its counts require {ends[-1]}")
    parts = [body[end - size : end] for end, size in zip(ends, sizes, strict=True)]
    residuals = np.frombuffer(parts[1], np.uint8).reshape(layout.num_planes, predicted)
    longs = np.frombuffer(parts[2], INT32).astype(np.int32)
    planes = np.frombuffer(parts[3], np.uint8).reshape(layout.num_planes, new)
    states = decode_new(planes, parts[4], sh_degree, levels)
    newcomers = _with_escapes(states, parts[5], parts[6])
    offsets = np.zeros(new, np.uint8)
    if has_start_offsets:
        offsets[:] = np.frombuffer(parts[7], np.uint8)
        if len(offsets) and offsets.max() >= layout.swin_size:
            raise CorruptError(
                f"change: start offset {offsets.max()} of {layout.swin_size} frames", ends[6]
            )
    return Change(residuals, longs, newcomers, offsets, levels)


def _part_sizes(
    layout: SlotLayout, counts: Sequence[int], has_start_offsets: bool
) -> tuple[int, ...]:
    """Bytes of the parts of a body with these COUNTS, in order."""
    predicted, new, long, escapes, low_bit_bytes = counts
    return (
        COUNTS.size,
        layout.num_planes * predicted,
        4 * long,
        layout.num_planes * new,
        low_bit_bytes,
        4 * escapes,
        bytes_per_gaussian(layout.sh_degree) * escapes,
        new if has_start_offsets else 0,
    )


def _with_escapes(states: States, numbers: memoryview, floats: memoryview) -> Newcomers:
    escaped = np.zeros(len(states), np.bool_)
    if not numbers:
        return Newcomers(states, escaped, Splats.empty(states.sh_degree))
    places = np.frombuffer(numbers, UINT32).astype(np.int64)
    if len(places) and (places[-1] >= len(states) or (np.diff(places) <= 0).any()):
        raise CorruptError(f"change: its escapes do not rise, or are not below {len(states)}")
    escaped[places] = True
    try:
        arrays = read_arrays(floats, len(places), states.sh_degree)
        escapes = Splats(*(array.astype(np.float32) for array in arrays))
    except InvalidError as error:
        raise CorruptError(f"change: {error}") from error
    return Newcomers(states, escaped, escapes)
