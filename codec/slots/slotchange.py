"""A change: what a slice brings to one layer (codec/FORMAT.md, section 10).

Rule: nothing is allocated before the counts in the bytes are those that the mask says, and no state
is touched: a `Change` is what the bytes say, and `Slots` says what becomes of it.
"""

from __future__ import annotations

import struct
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import accumulate

import numpy as np

from codec.arrays import Bytes, Flags, Ints
from codec.coders.coder import EncodedChunk
from codec.errors import CodecError, CorruptError, InvalidError
from codec.lattice.floats import bytes_per_gaussian, pack_arrays, read_arrays
from codec.lattice.lattice import States
from codec.splats import Splats

from .residual import decode_new, decode_predicted, encode_new, encode_predicted
from .slotchunk import Kind, SlotHeader
from .slotlayout import COUNTS_BYTES, HEADER_BYTES, MAX_SLOT_CHUNK_BYTES, SlotLayout

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
    # What stands before the first plane is one part, or two if there is something first.
    inner = {begin + edge for edge in body_edges} - {begin}
    return sorted({0, *({begin} if first_bytes else ()), *inner})


def encoded_elsewhere(layout: SlotLayout, kind: Kind, data: bytes) -> EncodedChunk:
    """The chunk of `kind` in `data`, which can be decoded, to be compressed once more."""
    header = SlotHeader.read(data, kind)
    if kind is Kind.MASK:
        return EncodedChunk(header.birth, data, (0, len(data)))
    first_bytes = layout.flags_bytes(header.layer) if kind is Kind.SNAPSHOT else 0
    counts = COUNTS.unpack_from(data, HEADER_BYTES + first_bytes)
    head, predicted, longs, new, *rest = _part_sizes(layout, counts, header.has_start_offsets)
    planes = layout.num_planes
    sizes = head, *[predicted // planes] * planes, longs, *[new // planes] * planes, *rest
    return EncodedChunk(header.birth, data, _chunk_edges(first_bytes, accumulate(sizes)))


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
    return finish_chunk(header, b"", body, edges)


def decode_change(
    layout: SlotLayout,
    layer: int,
    birth: int,
    data: bytes | memoryview,
    num_predicted: int,
    num_new: int,
) -> Change:
    """The change in `data`, whose counts are those of the mask; without data it brings nothing.
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
            f"change: it is missing, but the mask declares {num_predicted} predicted, {num_new} new"
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
            rule = "the mask declares" if n < 2 else "at most"
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
