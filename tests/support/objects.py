"""Objects of changes like those of a trained stream, and the chunks in an object."""

from __future__ import annotations

from collections.abc import Sequence

from codec.coders.coder import EncodedChunk
from codec.errors import CorruptError
from codec.lattice.lattice import Lattice, States
from codec.slots.change import Newcomers, encode_change
from codec.slots.slotlayout import SlotLayout
from codec.stream.segment import (
    encode_packet,
    entry_packet,
    join_packets,
    object_end,
    packet_content,
    read_object_table,
)
from codec.stream.wholeslice import opacity_rank, whole_update
from tests.support.trained_like import trained_like_slice

BIRTHS = (-2, -1, 0, 1, 5)
LIMIT_BYTES = 1 << 22


def new_chunk(birth: int, count: int, exact: bool = False) -> EncodedChunk:
    """A change in which `count` Gaussians are new. exact: all of them escape, as float32."""
    slice = trained_like_slice(birth, count)
    layout = SlotLayout(4, (max(count, 1),), 0, (Lattice.suiting(slice.splats),), 1)
    update = whole_update(slice, layout, opacity_rank, exact)
    none = States.zeros(0, 0)
    new = Newcomers(update.states, update.escaped, update.escapes)
    return encode_change(0, birth, none, none, new, update.start_offsets)


def new_chunks(count: int = 12, exact: bool = False) -> list[EncodedChunk]:
    return [new_chunk(birth, count, exact) for birth in BIRTHS]


def object_of(chunks: Sequence[EncodedChunk]) -> bytes:
    return join_packets([(one.birth, encode_packet(one)) for one in chunks])


def object_packets(data: bytes) -> list[tuple[int, bytes]]:
    """(birth, packet) of each chunk of the whole object `data`, in order. Raises a CodecError."""
    entries = read_object_table(data)
    if object_end(entries) != len(data):
        raise CorruptError(f"object: {len(data)} bytes, its table says {object_end(entries)}")
    return [(entry.birth, bytes(entry_packet(data, entry))) for entry in entries]


def contents(data: bytes) -> list[bytes]:
    """The chunks in the object `data`. Raises a CodecError."""
    return [packet_content(packet, LIMIT_BYTES) for _, packet in object_packets(data)]
