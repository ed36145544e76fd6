"""The coder that browsers know: valid gzip for anyone, and no bomb goes off."""

from __future__ import annotations

import gzip
import json
import random
import shutil
import struct
import subprocess
import tracemalloc
import zlib
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from codec.coders import gzip as gzip_coder
from codec.coders.coder import Coder, EncodedChunk, coder_of, compress, decompress
from codec.errors import CorruptError
from codec.profiles.profile import CHUNK_PROFILES, Profile
from codec.stream.chunk import MAX_CHUNK_BYTES, encode_chunk
from codec.stream.object import (
    HEAD,
    decode_object,
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
NODE = shutil.which("node")


def encoded(profile: Profile = Profile.COMPACT, count: int = 12) -> list[EncodedChunk]:
    return [encode_chunk(trained_like_slice(birth, count), 1, profile) for birth in BIRTHS]


@pytest.mark.parametrize("profile", CHUNK_PROFILES)
def test_a_packet_is_one_gzip_member_for_anyone(profile: Profile) -> None:
    chunks = encoded(profile, 3000)
    for (birth, packet), chunk, wanted in zip(
        object_packets(encode_object(chunks, Coder.GZIP)), chunks, BIRTHS, strict=True
    ):
        assert birth == wanted
        content = chunk.data
        assert gzip.decompress(packet) == content == decompress(packet, len(content))
        assert packet[:10] == b"\x1f\x8b\x08\0\0\0\0\0\x02\xff"
        assert packet[-8:] == struct.pack("<II", zlib.crc32(content), len(content))
        assert coder_of(packet) is Coder.GZIP


def test_the_coder_changes_no_value() -> None:
    chunks = encoded()
    pairs = zip(
        decode_object(encode_object(chunks)),
        decode_object(encode_object(chunks, Coder.GZIP)),
        strict=True,
    )
    for zstd, gzipped in pairs:
        assert (zstd.birth, zstd.layer, zstd.profile) == (
            gzipped.birth,
            gzipped.layer,
            gzipped.profile,
        )
        for name in ("means", "log_scales", "quats", "logit_opacities", "sh"):
            ours, theirs = (getattr(chunk.slice.splats, name) for chunk in (zstd, gzipped))
            assert ours.tobytes() == theirs.tobytes()
        assert np.array_equal(zstd.slice.start_offsets, gzipped.slice.start_offsets)


def test_the_table_is_pinned() -> None:
    data = encode_object(encoded(), Coder.GZIP)
    head = struct.unpack_from("<II4sBBHI", data)
    assert head == (0x184D2A50, 12 + 12 * 5, b"SWGO", 1, 2, 0, 5)
    assert data[20 + 12 * 5 :][:4] == b"\x1f\x8b\x08\0"


@pytest.mark.parametrize("coder", list(Coder))
def test_packets_of_another_coder_than_the_table_s_are_refused(coder: Coder) -> None:
    other = next(c for c in Coder if c is not coder)
    packets = [(birth, encode_packet(c, other)) for birth, c in zip(BIRTHS, encoded(), strict=True)]
    with pytest.raises(CorruptError, match="not of the object's coder"):
        decode_object(join_packets(packets, coder))


def test_every_truncation_is_refused() -> None:
    data = encode_object(encoded(count=5), Coder.GZIP)
    for cut in truncations(data):
        assert not survives(decode_object, cut)
        survives(read_object_table, cut)
    assert not survives(decode_object, data + b"\0")
    packet = encode_packet(encoded(count=5)[0], Coder.GZIP)
    for cut in truncations(packet):
        assert not survives(decode_packet, cut)


def test_an_altered_byte_never_passes() -> None:
    """But for what means nothing: six bytes of the head, and bits that fill deflate's last byte."""
    chunk = encoded(count=5)[0]
    packet = encode_packet(chunk, Coder.GZIP)
    passed = [altered for altered in flips(packet) if survives(decode_packet, altered)]
    assert all(decompress(altered, len(chunk.data)) == chunk.data for altered in passed)
    assert len(passed) <= 3 * (6 + 1)


@given(st.binary(max_size=200))
@settings(max_examples=200)
def test_noise(noise: bytes) -> None:
    for data in (
        gzip_coder.MAGIC + noise,
        gzip_coder.HEAD + noise + struct.pack("<II", 0, 200),
        HEAD.pack(0x184D2A50, 24, b"SWGO", 1, 2, 0, 1) + noise,
    ):
        for decode in (decode_object, decode_packet, read_object_table, object_packets):
            survives(decode, data)


def bomb(size: int) -> bytes:
    return compress(bytes(size), (), Coder.GZIP)


BOMB = bomb(1 << 24)


def claiming(size: int, packet: bytes) -> bytes:
    """`packet` with another content size in its trailer."""
    return packet[:-4] + struct.pack("<I", size)


def with_name(packet: bytes) -> bytes:
    """A valid gzip member, but with a file name in its head."""
    return packet[:3] + b"\x08" + packet[4:10] + b"name\0" + packet[10:]


@pytest.mark.parametrize(
    ("packet", "says"),
    [
        # Says more than a chunk can have, and is long enough for it: refused unread.
        (claiming(MAX_CHUNK_BYTES + 1, gzip_coder.HEAD + bytes(300_000)), "at most"),
        # Says more than deflate can give.
        (claiming(1 << 20, bomb(1000)), "cannot come from"),
        # Goes on beyond what it says: 16 MiB of zeros that claim to be few.
        (claiming(0, BOMB), "more content than the 0 bytes"),
        (claiming(1000, BOMB), "more content than the 1000 bytes"),
        # Ends before it.
        (claiming(1001, bomb(1000)), "packet: "),
        # More than one member, or something behind it.
        (bomb(100) + bomb(100), "follows"),
        (bomb(100) + b"x" + bomb(100)[-8:], "follows"),
        (bomb(100) + bytes(1 << 19) + bomb(100)[-8:], "follows"),
        # Wrong checksum.
        (bomb(100)[:-8] + bytes(4) + bomb(100)[-4:], "incorrect data check"),
        # Ends inside, with a trailer where deflate would go on.
        (bomb(1 << 16)[:30] + struct.pack("<II", 0, 1 << 14), "packet: "),
        (with_name(bomb(100)), "neither a zstd frame nor a gzip member"),
        # zlib's and no container at all.
        (zlib.compress(bytes(100)), "neither"),
        (b"\x1f\x8b\x08\0", "is not a gzip member"),
        (gzip_coder.HEAD + struct.pack("<II", 0, 0), "packet: "),
    ],
)
def test_packets_that_are_refused_before_they_grow(packet: bytes, says: str) -> None:
    tracemalloc.start()
    with pytest.raises(CorruptError, match=says):
        decode_packet(packet)
    peak_bytes = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak_bytes < 3 << 20


def test_the_cap_is_that_of_the_caller() -> None:
    packet = bomb(5000)
    assert decompress(packet, 5000) == bytes(5000)
    with pytest.raises(CorruptError, match="5000 bytes of content, at most 4999"):
        decompress(packet, 4999)


def test_a_large_packet_is_held_once() -> None:
    content = random.Random(1).randbytes(1 << 22)
    packet = compress(content, (), Coder.GZIP)
    tracemalloc.start()
    found = decompress(packet, len(content))
    peak_bytes = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert found == content
    assert peak_bytes < 1.5 * len(content)


def test_what_shrinks_as_far_as_deflate_can_still_comes_back() -> None:
    content = bytes(1 << 24)
    packet = compress(content, (), Coder.GZIP)
    assert len(packet) < len(content) / 1000
    assert decompress(packet, len(content)) == content


@given(st.lists(st.binary(max_size=300), min_size=1, max_size=6))
@settings(max_examples=60, deadline=None)
def test_the_coder_keeps_content_wherever_blocks_end(planes: list[bytes]) -> None:
    content = b"".join(planes)
    edges = [0, *np.cumsum([len(plane) for plane in planes]).tolist()]
    for packet in (compress(content, edges, Coder.GZIP), compress(content, (), Coder.GZIP)):
        assert decompress(packet, len(content)) == content == gzip.decompress(packet)


def test_ending_blocks_between_planes_makes_gzip_as_small_as_zstd() -> None:
    chunk = encode_chunk(trained_like_slice(0, 4000), 0, Profile.COMPACT)
    packet = encode_packet(chunk, Coder.GZIP)
    assert len(packet) < 0.95 * len(gzip.compress(chunk.data, 9))
    assert len(packet) < 1.02 * len(encode_packet(chunk))


# What a browser has, and no code of ours: fetch, DataView, DecompressionStream.
SCRIPT = """
const data = require("fs").readFileSync(process.argv[1]);
const view = new DataView(data.buffer, data.byteOffset, data.length);
async function main() {
  const chunks = [];
  for (let n = 0; n < view.getUint32(16, true); n++) {
    const offset = view.getUint32(24 + 12 * n, true), size = view.getUint32(28 + 12 * n, true);
    const packet = new Blob([data.subarray(offset, offset + size)]);
    const inflated = packet.stream().pipeThrough(new DecompressionStream("gzip"));
    const chunk = Buffer.from(await new Response(inflated).arrayBuffer());
    chunks.push(chunk.toString("hex"));
  }
  console.log(JSON.stringify(chunks));
}
main();
"""


@pytest.mark.skipif(NODE is None, reason="node is not installed")
def test_a_browser_s_decompression_stream_gives_the_chunks(tmp_path: Path) -> None:
    assert NODE is not None
    chunks = encoded(count=200)
    (tmp_path / "object").write_bytes(encode_object(chunks, Coder.GZIP))
    done = subprocess.run(
        [NODE, "-e", SCRIPT, str(tmp_path / "object")], capture_output=True, text=True, timeout=60
    )
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout) == [chunk.data.hex() for chunk in chunks]
