"""Objects and packets: frames of zstd; and no bomb is decompressed."""

from __future__ import annotations

import struct

import numpy as np
import pytest
import zstandard
from hypothesis import given, settings
from hypothesis import strategies as st

from codec.coders.zstd import compress, decompress
from codec.errors import CorruptError, InvalidError
from codec.slots.slotlayout import MAX_SLOT_CHUNK_BYTES
from codec.stream.segment import (
    MAX_CHUNKS_PER_OBJECT,
    encode_packet,
    join_packets,
    packet_content,
    read_object_table,
)
from tests.support.hostile import flips, refused, survives, truncations, within_bytes
from tests.support.objects import BIRTHS, contents, new_chunk, new_chunks, object_of, object_packets


def packet_of_any_stream(packet: bytes) -> bytes:
    return packet_content(packet, MAX_SLOT_CHUNK_BYTES)


@pytest.mark.parametrize("exact", [False, True])
def test_a_frame_says_its_size_and_has_a_checksum(exact: bool) -> None:
    for chunk in new_chunks(3000, exact):
        packet = compress(chunk.data, chunk.edges)
        assert zstandard.ZstdDecompressor().decompress(packet) == chunk.data
        parameters = zstandard.get_frame_parameters(packet)
        assert parameters.content_size == len(chunk.data)
        assert parameters.has_checksum


def test_an_object_may_be_empty_and_leaves_out_packets_of_no_bytes() -> None:
    assert contents(join_packets([])) == []
    chunk = new_chunk(3, 5)
    data = join_packets([(1, b""), (3, encode_packet(chunk)), (4, b"")])
    assert data == object_of([chunk])
    assert packet_content(b"", 9) == b""
    refused(CorruptError, "its content is empty", packet_content, compress(b""), 9)


def test_every_truncation_is_refused() -> None:
    for cut in truncations(object_of(new_chunks(5))):
        assert not survives(contents, cut)
        survives(read_object_table, cut)
    packet = encode_packet(new_chunk(0, 5))
    for cut in list(truncations(packet))[1:]:  # an empty packet means that nothing changes
        assert not survives(packet_of_any_stream, cut)


def test_an_altered_byte_never_passes() -> None:
    """Except meaningless ones: the bits of the head that say nothing."""
    chunk = new_chunk(0, 5)
    packet = encode_packet(chunk)
    passed = [altered for altered in flips(packet) if survives(packet_of_any_stream, altered)]
    assert all(packet_of_any_stream(altered) == chunk.data for altered in passed)
    assert len(passed) <= 3 * (6 + 1)


def test_what_is_not_an_object_is_not_written(monkeypatch: pytest.MonkeyPatch) -> None:
    chunks = new_chunks()
    for wrong in ([chunks[0], chunks[0]], [chunks[1], chunks[0]]):
        refused(InvalidError, "do not rise", object_of, wrong)
    size = len(object_of(chunks))
    monkeypatch.setattr("codec.stream.segment.MAX_OBJECT_BYTES", size - 1)
    refused(InvalidError, "use shorter segments", object_of, chunks)
    with pytest.raises(InvalidError, match="16385 chunks, at most 16384"):
        join_packets([(birth, b"x") for birth in range(MAX_CHUNKS_PER_OBJECT + 1)])


def bomb(size: int) -> bytes:
    return zstandard.ZstdCompressor(write_checksum=True).compress(bytes(size))


def claiming(size: int) -> bytes:
    """The start of a packet that claims a content of `size` bytes."""
    compressor = zstandard.ZstdCompressor(write_checksum=True).compressobj(size)
    return compressor.compress(b"x") + compressor.flush(zstandard.COMPRESSOBJ_FLUSH_BLOCK)


@pytest.mark.parametrize(
    "packet",
    [
        claiming(MAX_SLOT_CHUNK_BYTES + 1),
        # More content than can come from its bytes, or than it has.
        claiming(1 << 20),
        claiming(1 << 18),
        # No content size.
        zstandard.ZstdCompressor(write_content_size=False, write_checksum=True).compress(b"x" * 99),
        # No checksum.
        zstandard.ZstdCompressor(write_checksum=False).compress(b"x" * 99),
        # More than one packet, or data after it.
        bomb(100) + bomb(100),
        bomb(100) + b"x",
        # Skippable.
        struct.pack("<II", 0x184D2A50, 4) + b"none",
        # Claims less, and more, than its content.
        bomb(1000)[:5] + struct.pack("<H", 1) + bomb(1000)[7:],
        bomb(1000)[:5] + struct.pack("<H", 60_000) + bomb(1000)[7:],
        b"\x28\xb5\x2f\xfd",
    ],
)
def test_packets_that_are_refused_before_they_grow(packet: bytes) -> None:
    with within_bytes(1 << 20), pytest.raises(CorruptError):
        packet_of_any_stream(packet)


def test_what_shrinks_as_far_as_it_can_still_comes_back() -> None:
    content = bytes(1 << 24)
    packet = compress(content)
    assert len(packet) < len(content) / 1000
    assert decompress(packet, len(content)) == content


@given(planes=st.lists(st.binary(max_size=300), min_size=1, max_size=6))
@settings(max_examples=60, deadline=None)
def test_the_coder_keeps_content_wherever_blocks_end(planes: list[bytes]) -> None:
    content = b"".join(planes)
    edges = [0, *np.cumsum([len(plane) for plane in planes]).tolist()]
    for packet in (compress(content, edges), compress(content)):
        assert decompress(packet, len(content)) == content
        if content:
            with pytest.raises(CorruptError, match=f"at most {len(content) - 1}"):
                decompress(packet, len(content) - 1)


def test_ending_blocks_between_planes_pays() -> None:
    chunk = new_chunk(0, 4000)
    plain = zstandard.ZstdCompressor(level=19, write_checksum=True).compress(chunk.data)
    assert len(encode_packet(chunk)) < 0.97 * len(plain)


def test_all_chunks_come_back_in_order() -> None:
    chunks = new_chunks()
    data = object_of(chunks)
    assert contents(data) == [chunk.data for chunk in chunks]
    assert [birth for birth, _ in object_packets(data)] == list(BIRTHS)
    assert [entry.birth for entry in read_object_table(data)] == list(BIRTHS)
    assert read_object_table(data[: 20 + 12 * 5]) == read_object_table(data)
    no_frame = [(chunk.birth, b"no frame") for chunk in chunks]
    refused(CorruptError, "nor a zstd frame", contents, join_packets(no_frame))
