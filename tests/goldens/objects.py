"""Reads packets and objects (section 6), written from codec/FORMAT.md alone."""

from __future__ import annotations

import struct
from itertools import pairwise

import zstandard

from tests.goldens.decoder import Unsupported

LARGEST_CHUNK = 248512624
LARGEST_OBJECT = 2**30


def inflate(packet: bytes, largest: int) -> bytes:
    """The chunk in a packet, if it has at most `largest` bytes."""
    try:
        return inflated(packet, largest)
    except zstandard.ZstdError as error:
        raise AssertionError(error) from error


def inflated(packet: bytes, largest: int) -> bytes:
    assert packet[:4] == b"\x28\xb5\x2f\xfd"
    said = zstandard.get_frame_parameters(packet)
    assert said.has_checksum
    assert said.dict_id == 0
    assert said.content_size <= min(32768 * len(packet), largest)
    return zstandard.ZstdDecompressor().decompress(packet, allow_extra_data=False)


def decode_object(data: bytes, largest: int = LARGEST_CHUNK) -> list[bytes]:
    """The chunks of an object, inflated, in order; each has at most `largest` bytes."""
    assert 20 <= len(data) <= LARGEST_OBJECT
    skippable, following, magic, version, coder, zero, count = struct.unpack_from("<II4sBBHI", data)
    assert (skippable, following) == (0x184D2A50, 12 + 12 * count)
    assert magic == b"SWGO"
    if version != 1 or coder != 1:
        raise Unsupported
    assert zero == 0
    assert count <= 16384
    assert len(data) >= 20 + 12 * count
    chunks, end, births = [], 20 + 12 * count, []
    for entry in range(count):
        birth, offset, size = struct.unpack_from("<iII", data, 20 + 12 * entry)
        assert offset == end
        end += size
        assert end <= len(data)
        packet = data[offset:end]
        chunks.append(inflate(packet, largest))
        assert chunks[-1][8:12] == struct.pack("<i", birth)
        births.append(birth)
    assert all(earlier < later for earlier, later in pairwise(births))
    assert end == len(data)
    return chunks
