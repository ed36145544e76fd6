"""The coder for browsers: the output is valid gzip, and no bomb is inflated."""

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

import pytest

from codec.coders import gzip as gzip_coder
from codec.coders.coder import Coder, coder_of, compress, decompress
from codec.errors import CorruptError
from codec.slots.slotlayout import MAX_SLOT_CHUNK_BYTES
from codec.stream.object import encode_packet, join_packets, packet_content
from tests.support.hostile import within_bytes
from tests.support.objects import BIRTHS, contents, new_chunk, new_chunks, object_of, object_packets

NODE = shutil.which("node")


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


@pytest.mark.parametrize("coder", list(Coder))
def test_packets_of_another_coder_than_the_table_s_are_refused(coder: Coder) -> None:
    other = next(c for c in Coder if c is not coder)
    packets = [(chunk.birth, encode_packet(chunk, other)) for chunk in new_chunks()]
    with pytest.raises(CorruptError, match="not of the object's coder"):
        contents(join_packets(packets, coder))


def bomb(size: int) -> bytes:
    return compress(bytes(size), (), Coder.GZIP)


BOMB = bomb(1 << 24)


def claiming(size: int, packet: bytes) -> bytes:
    """`packet` with another content size in its trailer."""
    return packet[:-4] + struct.pack("<I", size)


def with_name(packet: bytes) -> bytes:
    """A valid gzip member with a file name in its head."""
    return packet[:3] + b"\x08" + packet[4:10] + b"name\0" + packet[10:]


@pytest.mark.parametrize(
    ("packet", "says"),
    [
        # Claims more than a chunk may have, and is long enough for it: refused unread.
        (claiming(MAX_SLOT_CHUNK_BYTES + 1, gzip_coder.HEAD + bytes(300_000)), "at most"),
        # Claims more than deflate can produce.
        (claiming(1 << 20, bomb(1000)), "cannot come from"),
        # Has more content than it claims: 16 MiB of zeros.
        (claiming(0, BOMB), "more content than the 0 bytes"),
        (claiming(1000, BOMB), "more content than the 1000 bytes"),
        # Has less content than it claims.
        (claiming(1001, bomb(1000)), "packet: "),
        # More than one member, or data after it.
        (bomb(100) + bomb(100), "follows"),
        (bomb(100) + b"x" + bomb(100)[-8:], "follows"),
        (bomb(100) + bytes(1 << 19) + bomb(100)[-8:], "follows"),
        # Wrong checksum.
        (bomb(100)[:-8] + bytes(4) + bomb(100)[-4:], "incorrect data check"),
        # Truncated, with a trailer where deflate data would continue.
        (bomb(1 << 16)[:30] + struct.pack("<II", 0, 1 << 14), "packet: "),
        (with_name(bomb(100)), "neither a zstd frame nor a gzip member"),
        # The container of zlib, and none at all.
        (zlib.compress(bytes(100)), "neither"),
        (b"\x1f\x8b\x08\0", "is not a gzip member"),
        (gzip_coder.HEAD + struct.pack("<II", 0, 0), "packet: "),
    ],
)
def test_packets_that_are_refused_before_they_grow(packet: bytes, says: str) -> None:
    with within_bytes(3 << 20), pytest.raises(CorruptError, match=says):
        packet_content(packet, MAX_SLOT_CHUNK_BYTES)


def test_a_large_packet_is_held_once() -> None:
    content = random.Random(1).randbytes(1 << 22)
    packet = compress(content, (), Coder.GZIP)
    tracemalloc.start()
    found = decompress(packet, len(content))
    peak_bytes = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert found == content
    assert peak_bytes < 1.5 * len(content)


def test_ending_blocks_between_planes_makes_gzip_as_small_as_zstd() -> None:
    chunk = new_chunk(0, 4000)
    packet = encode_packet(chunk, Coder.GZIP)
    assert len(packet) < 0.95 * len(gzip.compress(chunk.data, 9))
    assert len(packet) < 1.02 * len(encode_packet(chunk))


# Only features of browsers, none of our code: fetch, DataView, DecompressionStream.
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
    chunks = new_chunks(200)
    (tmp_path / "object").write_bytes(object_of(chunks, Coder.GZIP))
    done = subprocess.run(
        [NODE, "-e", SCRIPT, str(tmp_path / "object")], capture_output=True, text=True, timeout=60
    )
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout) == [chunk.data.hex() for chunk in chunks]
