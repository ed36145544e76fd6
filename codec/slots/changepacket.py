"""The packet of a change whose planes are coded (codec/FORMAT.md, section 10.5), and back to the
chunk, byte for byte.

Rule: nothing is allocated before the counts in the bytes are within what the caller allows.
"""

from __future__ import annotations

import struct
import zlib

import numpy as np

from codec.coders.planes import decode_planes, encode_planes, read_numbers
from codec.coders.zstd import MAX_EXPANSION
from codec.errors import CorruptError, UnsupportedError
from codec.lattice.lattice import num_attributes

from .change import COUNTS
from .slotlayout import FLAG_SLOT_OFFSETS, HEADER_BYTES, Kind, SlotHeader

FORM = 1
"""The first byte of such a packet, with which no zstd frame begins."""

# form, flags, layer, zero, birth
HEAD = struct.Struct("<BBBBi")
CHECKSUM = struct.Struct("<I")

SH_DEGREE_BITS = 2
"""Bits of the flags that have the SH degree; the next one says that start offsets are stored."""

FIRST_PLANE = HEADER_BYTES + COUNTS.size
"""Where in a change its planes begin."""


def encode_change_packet(chunk: bytes, sh_degree: int) -> bytes:
    """The packet of the change in `chunk`."""
    header = SlotHeader.read(chunk, Kind.CHANGE)
    num_predicted, num_new, longs, escapes, _ = COUNTS.unpack_from(chunk, HEADER_BYTES)
    planes = 3 + num_attributes(sh_degree)
    longs_at = FIRST_PLANE + planes * num_predicted
    new_at = longs_at + 4 * longs
    rest_at = new_at + planes * num_new
    data = np.frombuffer(chunk, np.uint8)
    coded = encode_planes(
        (num_predicted, num_new, escapes),
        data[FIRST_PLANE:longs_at].reshape(planes, num_predicted),
        data[new_at:rest_at].reshape(planes, num_new),
    )
    flags = sh_degree | header.has_start_offsets << SH_DEGREE_BITS
    head = HEAD.pack(FORM, flags, header.layer, 0, header.birth)
    return sealed(head + coded + chunk[longs_at:new_at] + chunk[rest_at:])


def renumbered_change(packet: bytes, birth: int) -> bytes:
    """`packet`, one of `encode_change_packet`, as that of another birth."""
    *fields, _ = HEAD.unpack_from(packet)
    return sealed(HEAD.pack(*fields, birth) + packet[HEAD.size : -CHECKSUM.size])


def sealed(packet: bytes) -> bytes:
    """`packet` with its checksum."""
    return packet + CHECKSUM.pack(zlib.crc32(packet))


def change_content(packet: bytes | memoryview, limit_bytes: int) -> bytes:
    """The chunk in a packet of `encode_change_packet`, at most `limit_bytes`. Raises a
    CodecError."""
    body_end = len(packet) - CHECKSUM.size
    if body_end < HEAD.size:
        raise CorruptError(f"packet: {len(packet)} bytes are too few for a change")
    if CHECKSUM.unpack_from(packet, body_end)[0] != zlib.crc32(packet[:body_end]):
        raise CorruptError("packet: has a wrong checksum")
    _, flags, layer, zero, birth = HEAD.unpack_from(packet)
    if flags >> SH_DEGREE_BITS > FLAG_SLOT_OFFSETS or zero:
        raise UnsupportedError("packet: a reserved bit is set")
    body = memoryview(packet)[HEAD.size : body_end]
    (num_predicted, num_new, escapes), at = read_numbers(body, 3)
    planes = 3 + num_attributes(flags & (1 << SH_DEGREE_BITS) - 1)
    size = FIRST_PLANE + planes * (num_predicted + num_new)
    most = min(limit_bytes, MAX_EXPANSION * len(packet))
    if size > most:
        raise CorruptError(f"packet: {size} bytes of content, at most {most}")
    predicted = np.empty((planes, num_predicted), np.uint8)
    new = np.empty((planes, num_new), np.uint8)
    end, longs, low_bits = decode_planes(body, at, predicted, new)
    rest = _rest(body, end)
    if 4 * longs > len(rest) or size + len(rest) > most:
        raise CorruptError(f"packet: {len(rest)} bytes behind its planes are too few or too many")
    counts = COUNTS.pack(num_predicted, num_new, longs, escapes, (low_bits + 7) // 8)
    head = SlotHeader(Kind.CHANGE, layer, birth, bool(flags >> SH_DEGREE_BITS)).pack()
    longs_end = 4 * longs
    parts = head, counts, predicted.data, rest[:longs_end], new.data, rest[longs_end:]
    return b"".join(parts)


def _rest(body: memoryview, num_bits: int) -> memoryview:
    """The bytes behind the planes, which take num_bits, -1 if they are damaged."""
    end = (num_bits + 7) >> 3
    if num_bits < 0 or end > len(body):
        raise CorruptError("packet: its planes are damaged")
    if num_bits & 7 and body[end - 1] >> (num_bits & 7):
        raise CorruptError("packet: a bit is set after its planes")
    return body[end:]
