"""Objects and packets: valid zstd for anyone, and no bomb goes off."""

from __future__ import annotations

import struct
import tracemalloc

import numpy as np
import pytest
import zstandard
from hypothesis import given, settings
from hypothesis import strategies as st

from codec.coders.coder import EncodedChunk, compress, decompress
from codec.errors import CorruptError, InvalidError, UnsupportedError
from codec.profiles.profile import CHUNK_PROFILES, Profile
from codec.stream.chunk import MAX_CHUNK_BYTES, encode_chunk
from codec.stream.object import (
    ENTRY,
    HEAD,
    MAX_CHUNKS_PER_OBJECT,
    decode_object,
    decode_object_chunk,
    decode_packet,
    encode_object,
    encode_packet,
    join_packets,
    object_packets,
    read_object_table,
)
from tests.support.hostile import flips, survives, truncations
from tests.support.trained_like import trained_like_slice

BIRTHS = (-2, -1, 0, 1, 5)


def encoded(profile: Profile = Profile.COMPACT, count: int = 12) -> list[EncodedChunk]:
    return [encode_chunk(trained_like_slice(birth, count), 1, profile) for birth in BIRTHS]


def test_all_chunks_come_back_in_order() -> None:
    chunks = encoded()
    data = encode_object(chunks)
    decoded = decode_object(data)
    assert [chunk.birth for chunk in decoded] == list(BIRTHS)
    assert [packet[0] for packet in object_packets(data)] == list(BIRTHS)
    for entry, chunk, (_, packet) in zip(
        read_object_table(data), decoded, object_packets(data), strict=True
    ):
        for other in (decode_object_chunk(data, entry), decode_packet(packet)):
            assert (other.slice.splats.means == chunk.slice.splats.means).all()


@pytest.mark.parametrize("profile", CHUNK_PROFILES)
def test_an_object_is_one_valid_zstd_stream(profile: Profile) -> None:
    chunks = encoded(profile, 3000)
    data = encode_object(chunks)
    reader = zstandard.ZstdDecompressor().stream_reader(data, read_across_frames=True)
    assert reader.read() == b"".join(chunk.data for chunk in chunks)
    for (_, packet), chunk in zip(object_packets(data), chunks, strict=True):
        parameters = zstandard.get_frame_parameters(packet)
        assert parameters.content_size == len(chunk.data)
        assert parameters.has_checksum


def test_the_table_is_pinned() -> None:
    data = encode_object(encoded())
    assert (HEAD.size, ENTRY.size) == (20, 12)
    head = struct.unpack_from("<II4sBBHI", data)
    assert head == (0x184D2A50, 12 + 12 * 5, b"SWGO", 1, 1, 0, 5)
    births = [struct.unpack_from("<i", data, 20 + 12 * n)[0] for n in range(5)]
    assert births == list(BIRTHS)
    first = struct.unpack_from("<II", data, 24)
    assert first[0] == 20 + 12 * 5
    assert data[first[0] : first[0] + 4] == b"\x28\xb5\x2f\xfd"


def test_a_table_is_read_from_the_front_alone() -> None:
    data = encode_object(encoded())
    assert read_object_table(data[: 20 + 12 * 5]) == read_object_table(data)


def test_every_truncation_is_refused() -> None:
    data = encode_object(encoded(count=5))
    for cut in truncations(data):
        assert not survives(decode_object, cut)
        survives(read_object_table, cut)
    assert not survives(decode_object, data + b"\0")


def test_an_altered_byte_never_passes() -> None:
    data = encode_object(encoded(count=5))
    for altered in flips(data, every=3):
        # The checksums of zstd cover the content; a frame header may alter harmlessly.
        if survives(decode_object, altered):
            assert len(decode_object(altered)) == len(BIRTHS)


@given(st.binary(max_size=200))
@settings(max_examples=200)
def test_noise(noise: bytes) -> None:
    for decode in (decode_object, decode_packet, read_object_table, object_packets):
        survives(decode, noise)
        survives(decode, struct.pack("<I", 0xFD2FB528) + noise)
        survives(decode, HEAD.pack(0x184D2A50, 24, b"SWGO", 1, 1, 0, 1) + noise)


@pytest.mark.parametrize(
    ("place", "value", "error"),
    [
        (0, b"\x51", CorruptError),
        (4, b"\0", CorruptError),
        (8, b"X", CorruptError),
        (12, b"\2", UnsupportedError),
        (13, b"\2", CorruptError),  # a coder, but not that of the packets
        (13, b"\3", UnsupportedError),
        (14, b"\1", CorruptError),
        (16, struct.pack("<I", 0), CorruptError),
        (16, struct.pack("<I", MAX_CHUNKS_PER_OBJECT + 1), CorruptError),
        (20, struct.pack("<i", 3), CorruptError),
        (24, struct.pack("<I", 0), CorruptError),
        (28, struct.pack("<I", 0xFFFFFFFF), CorruptError),
    ],
)
def test_a_table_that_breaks_a_rule(place: int, value: bytes, error: type[Exception]) -> None:
    data = bytearray(encode_object(encoded()))
    data[place : place + len(value)] = value
    with pytest.raises(error):
        decode_object(bytes(data))


def test_a_chunk_under_another_birth_is_refused() -> None:
    packets = [encode_packet(chunk) for chunk in encoded()]
    data = join_packets([(0, packets[0]), (1, packets[1])])
    with pytest.raises(CorruptError, match="birth -2 where the table says 0"):
        decode_object(data)


def test_what_is_not_an_object_is_not_written() -> None:
    chunks = encoded()
    for wrong in ([], [chunks[0], chunks[0]], [chunks[1], chunks[0]]):
        with pytest.raises(InvalidError):
            encode_object(wrong)


def bomb(size: int) -> bytes:
    return zstandard.ZstdCompressor(write_checksum=True).compress(bytes(size))


def claiming(size: int) -> bytes:
    """The start of a packet that says it holds `size` bytes."""
    compressor = zstandard.ZstdCompressor(write_checksum=True).compressobj(size)
    return compressor.compress(b"x") + compressor.flush(zstandard.COMPRESSOBJ_FLUSH_BLOCK)


@pytest.mark.parametrize(
    "packet",
    [
        claiming(MAX_CHUNK_BYTES + 1),
        # No content size.
        zstandard.ZstdCompressor(write_content_size=False, write_checksum=True).compress(b"x" * 99),
        # No checksum.
        zstandard.ZstdCompressor(write_checksum=False).compress(b"x" * 99),
        # More than one packet, or something behind it.
        bomb(100) + bomb(100),
        bomb(100) + b"x",
        # Skippable.
        struct.pack("<II", 0x184D2A50, 4) + b"none",
        # Says less, and more, than it holds.
        bomb(1000)[:5] + struct.pack("<H", 1) + bomb(1000)[7:],
        bomb(1000)[:5] + struct.pack("<H", 60_000) + bomb(1000)[7:],
        b"",
        b"\x28\xb5\x2f\xfd",
    ],
)
def test_packets_that_are_refused_before_they_grow(packet: bytes) -> None:
    tracemalloc.start()
    with pytest.raises(CorruptError):
        decode_packet(packet)
    peak_bytes = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak_bytes < 1 << 20


def test_a_packet_that_holds_less_than_it_says_is_refused() -> None:
    with pytest.raises(CorruptError, match="cannot come from"):
        decode_packet(claiming(1 << 20))
    with pytest.raises(CorruptError):
        decode_packet(claiming(1 << 18))


def test_what_shrinks_as_far_as_zstd_can_still_comes_back() -> None:
    content = bytes(1 << 24)
    assert decompress(compress(content), len(content)) == content


@given(st.lists(st.binary(max_size=300), min_size=1, max_size=6))
@settings(max_examples=60, deadline=None)
def test_the_coder_keeps_content_wherever_blocks_end(planes: list[bytes]) -> None:
    content = b"".join(planes)
    edges = [0, *np.cumsum([len(plane) for plane in planes]).tolist()]
    for packet in (compress(content, edges), compress(content)):
        assert decompress(packet, len(content)) == content
        if content:
            with pytest.raises(CorruptError):
                decompress(packet, len(content) - 1)


def test_ending_blocks_between_planes_pays() -> None:
    chunk = encode_chunk(trained_like_slice(0, 4000), 0, Profile.COMPACT)
    plain = zstandard.ZstdCompressor(level=19, write_checksum=True).compress(chunk.data)
    assert len(encode_packet(chunk)) < 0.97 * len(plain)
