"""Objects and packets: valid zstd, or gzip for browsers; and no bomb is inflated."""

from __future__ import annotations

import gzip
import random
import struct
import zlib

import numpy as np
import pytest
import zstandard
from hypothesis import given, settings
from hypothesis import strategies as st

from codec.coders import gzip as gzip_coder
from codec.coders.coder import Coder, coder_of, compress, decompress
from codec.errors import CorruptError, InvalidError
from codec.slots.slotlayout import MAX_SLOT_CHUNK_BYTES
from codec.stream.object import (
    MAX_CHUNKS_PER_OBJECT,
    encode_packet,
    join_packets,
    packet_content,
    read_object_table,
)
from tests.support.hostile import flips, refused, survives, truncations, within_bytes
from tests.support.objects import BIRTHS, contents, new_chunk, new_chunks, object_of, object_packets

coders = pytest.mark.parametrize("coder", list(Coder))


def packet_of_any_stream(packet: bytes) -> bytes:
    return packet_content(packet, MAX_SLOT_CHUNK_BYTES)


@pytest.mark.parametrize("exact", [False, True])
def test_an_object_is_one_valid_zstd_stream(exact: bool) -> None:
    chunks = new_chunks(3000, exact)
    data = object_of(chunks)
    reader = zstandard.ZstdDecompressor().stream_reader(data, read_across_frames=True)
    assert reader.read() == b"".join(chunk.data for chunk in chunks)
    for (_, packet), chunk in zip(object_packets(data), chunks, strict=True):
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


@coders
def test_every_truncation_is_refused(coder: Coder) -> None:
    for cut in truncations(object_of(new_chunks(5), coder)):
        assert not survives(contents, cut)
        survives(read_object_table, cut)
    packet = encode_packet(new_chunk(0, 5), coder)
    for cut in list(truncations(packet))[1:]:  # an empty packet means that nothing changes
        assert not survives(packet_of_any_stream, cut)


@coders
def test_an_altered_byte_never_passes(coder: Coder) -> None:
    """Except meaningless ones: bytes of the head, and padding bits of deflate's last byte."""
    chunk = new_chunk(0, 5)
    packet = encode_packet(chunk, coder)
    passed = [altered for altered in flips(packet) if survives(packet_of_any_stream, altered)]
    assert all(decompress(altered, len(chunk.data)) == chunk.data for altered in passed)
    assert len(passed) <= 3 * (6 + 1)


def test_what_is_not_an_object_is_not_written(monkeypatch: pytest.MonkeyPatch) -> None:
    chunks = new_chunks()
    for wrong in ([chunks[0], chunks[0]], [chunks[1], chunks[0]]):
        refused(InvalidError, "do not rise", object_of, wrong)
    size = len(object_of(chunks))
    monkeypatch.setattr("codec.stream.object.MAX_OBJECT_BYTES", size - 1)
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


@coders
def test_what_shrinks_as_far_as_it_can_still_comes_back(coder: Coder) -> None:
    content = bytes(1 << 24)
    packet = compress(content, (), coder)
    assert len(packet) < len(content) / 1000
    assert decompress(packet, len(content)) == content


@coders
@given(planes=st.lists(st.binary(max_size=300), min_size=1, max_size=6))
@settings(max_examples=60, deadline=None)
def test_the_coder_keeps_content_wherever_blocks_end(coder: Coder, planes: list[bytes]) -> None:
    content = b"".join(planes)
    edges = [0, *np.cumsum([len(plane) for plane in planes]).tolist()]
    for packet in (compress(content, edges, coder), compress(content, (), coder)):
        assert decompress(packet, len(content)) == content
        if content:
            with pytest.raises(CorruptError, match=f"at most {len(content) - 1}"):
                decompress(packet, len(content) - 1)


def test_ending_blocks_between_planes_pays() -> None:
    chunk = new_chunk(0, 4000)
    plain = zstandard.ZstdCompressor(level=19, write_checksum=True).compress(chunk.data)
    packets = {coder: encode_packet(chunk, coder) for coder in Coder}
    assert len(packets[Coder.ZSTD]) < 0.97 * len(plain)
    assert len(packets[Coder.GZIP]) < 0.95 * len(gzip.compress(chunk.data, 9))
    assert len(packets[Coder.GZIP]) < 1.02 * len(packets[Coder.ZSTD])


@pytest.mark.parametrize("exact", [False, True])
def test_a_packet_is_one_gzip_member_for_anyone(exact: bool) -> None:
    chunks = new_chunks(3000, exact)
    for (birth, packet), chunk, wanted in zip(
        object_packets(object_of(chunks, Coder.GZIP)), chunks, BIRTHS, strict=True
    ):
        assert birth == wanted
        content = chunk.data
        assert gzip.decompress(packet) == content == decompress(packet, len(content))
        assert packet[:10] == b"\x1f\x8b\x08\0\0\0\0\0\x02\xff"
        assert packet[-8:] == struct.pack("<II", zlib.crc32(content), len(content))
        assert coder_of(packet) is Coder.GZIP


@coders
def test_all_chunks_come_back_in_order_from_packets_of_the_coder_of_the_table(coder: Coder) -> None:
    chunks = new_chunks()
    data = object_of(chunks, coder)
    assert contents(data) == [chunk.data for chunk in chunks]
    assert [birth for birth, _ in object_packets(data)] == list(BIRTHS)
    assert [entry.birth for entry in read_object_table(data)] == list(BIRTHS)
    assert read_object_table(data[: 20 + 12 * 5]) == read_object_table(data)
    other = next(c for c in Coder if c is not coder)
    packets = [(chunk.birth, encode_packet(chunk, other)) for chunk in chunks]
    refused(CorruptError, "not of the object's coder", contents, join_packets(packets, coder))


def gzip_bomb(size: int) -> bytes:
    return compress(bytes(size), (), Coder.GZIP)


BOMB = gzip_bomb(1 << 24)


def gzip_claiming(size: int, packet: bytes) -> bytes:
    """`packet` with another content size in its trailer."""
    return packet[:-4] + struct.pack("<I", size)


def with_name(packet: bytes) -> bytes:
    """A valid gzip member with a file name in its head."""
    return packet[:3] + b"\x08" + packet[4:10] + b"name\0" + packet[10:]


@pytest.mark.parametrize(
    ("packet", "says"),
    [
        # Claims more than a chunk may have, and is long enough for it: refused unread.
        (gzip_claiming(MAX_SLOT_CHUNK_BYTES + 1, gzip_coder.HEAD + bytes(300_000)), "at most"),
        # Claims more than deflate can produce.
        (gzip_claiming(1 << 20, gzip_bomb(1000)), "cannot come from"),
        # Has more content than it claims: 16 MiB of zeros.
        (gzip_claiming(0, BOMB), "more content than the 0 bytes"),
        (gzip_claiming(1000, BOMB), "more content than the 1000 bytes"),
        # Has less content than it claims.
        (gzip_claiming(1001, gzip_bomb(1000)), "packet: "),
        # More than one member, or data after it.
        (gzip_bomb(100) + gzip_bomb(100), "follows"),
        (gzip_bomb(100) + b"x" + gzip_bomb(100)[-8:], "follows"),
        (gzip_bomb(100) + bytes(1 << 19) + gzip_bomb(100)[-8:], "follows"),
        # Wrong checksum.
        (gzip_bomb(100)[:-8] + bytes(4) + gzip_bomb(100)[-4:], "incorrect data check"),
        # Truncated, with a trailer where deflate data would continue.
        (gzip_bomb(1 << 16)[:30] + struct.pack("<II", 0, 1 << 14), "packet: "),
        (with_name(gzip_bomb(100)), "neither a zstd frame nor a gzip member"),
        # The container of zlib, and none at all.
        (zlib.compress(bytes(100)), "neither"),
        (b"\x1f\x8b\x08\0", "is not a gzip member"),
        (gzip_coder.HEAD + struct.pack("<II", 0, 0), "packet: "),
    ],
)
def test_gzip_that_is_refused_before_it_grows(packet: bytes, says: str) -> None:
    with within_bytes(3 << 20), pytest.raises(CorruptError, match=says):
        packet_content(packet, MAX_SLOT_CHUNK_BYTES)


def test_a_large_packet_is_held_once() -> None:
    content = random.Random(1).randbytes(1 << 22)
    packet = compress(content, (), Coder.GZIP)
    with within_bytes(len(content) * 3 // 2):
        assert decompress(packet, len(content)) == content
