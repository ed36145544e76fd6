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

from codec.coders import gzip as gzipframe
from codec.coders.coder import Coder, coder_of, compress, decompress
from codec.errors import CorruptError
from codec.profiles.profile import Profile
from codec.stream.chunk import MAX_CHUNK_BYTES, encode_chunk
from codec.stream.object import (
    HEAD,
    decode_frame,
    decode_object,
    encode_frame,
    encode_object,
    join_frames,
    object_frames,
    read_object_table,
)
from tests.support.hostile import flips, survives, truncations
from tests.support.trained_like import trained_like_slice

BIRTHS = (-2, -1, 0, 1, 5)
NODE = shutil.which("node")


def encoded(profile: Profile = Profile.COMPACT, count: int = 12) -> list[bytes]:
    return [encode_chunk(trained_like_slice(birth, count), 1, profile) for birth in BIRTHS]


@pytest.mark.parametrize("profile", list(Profile))
def test_a_frame_is_one_gzip_member_for_anyone(profile: Profile) -> None:
    chunks = encoded(profile, 3000)
    for (birth, frame), chunk, wanted in zip(
        object_frames(encode_object(chunks, Coder.GZIP)), chunks, BIRTHS, strict=True
    ):
        assert birth == wanted
        assert gzip.decompress(frame) == chunk == decompress(frame, len(chunk))
        assert frame[:10] == b"\x1f\x8b\x08\0\0\0\0\0\x02\xff"
        assert frame[-8:] == struct.pack("<II", zlib.crc32(chunk), len(chunk))
        assert coder_of(frame) is Coder.GZIP


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
def test_frames_of_another_coder_than_the_table_s_are_refused(coder: Coder) -> None:
    other = next(c for c in Coder if c is not coder)
    frames = [(birth, encode_frame(c, other)) for birth, c in zip(BIRTHS, encoded(), strict=True)]
    with pytest.raises(CorruptError, match="not of the object's coder"):
        decode_object(join_frames(frames, coder))


def test_every_truncation_is_refused() -> None:
    data = encode_object(encoded(count=5), Coder.GZIP)
    for cut in truncations(data):
        assert not survives(decode_object, cut)
        survives(read_object_table, cut)
    assert not survives(decode_object, data + b"\0")
    frame = encode_frame(encoded(count=5)[0], Coder.GZIP)
    for cut in truncations(frame):
        assert not survives(decode_frame, cut)


def test_an_altered_byte_never_passes() -> None:
    """But for what means nothing: six bytes of the head, and bits that fill deflate's last byte."""
    chunk = encoded(count=5)[0]
    frame = encode_frame(chunk, Coder.GZIP)
    passed = [altered for altered in flips(frame) if survives(decode_frame, altered)]
    assert all(decompress(altered, len(chunk)) == chunk for altered in passed)
    assert len(passed) <= 3 * (6 + 1)


@given(st.binary(max_size=200))
@settings(max_examples=200)
def test_noise(noise: bytes) -> None:
    for data in (
        gzipframe.MAGIC + noise,
        gzipframe.HEAD + noise + struct.pack("<II", 0, 200),
        HEAD.pack(0x184D2A50, 24, b"SWGO", 1, 2, 0, 1) + noise,
    ):
        for decode in (decode_object, decode_frame, read_object_table, object_frames):
            survives(decode, data)


def bomb(size: int) -> bytes:
    return compress(bytes(size), (), Coder.GZIP)


BOMB = bomb(1 << 24)


def claiming(size: int, frame: bytes) -> bytes:
    """`frame` with another content size in its trailer."""
    return frame[:-4] + struct.pack("<I", size)


def with_name(frame: bytes) -> bytes:
    """A valid gzip member, but with a file name in its head."""
    return frame[:3] + b"\x08" + frame[4:10] + b"name\0" + frame[10:]


@pytest.mark.parametrize(
    ("frame", "says"),
    [
        # Says more than a chunk can have, and is long enough for it: refused unread.
        (claiming(MAX_CHUNK_BYTES + 1, gzipframe.HEAD + bytes(300_000)), "at most"),
        # Says more than deflate can give.
        (claiming(1 << 20, bomb(1000)), "cannot come from"),
        # Goes on beyond what it says: 16 MiB of zeros that claim to be few.
        (claiming(0, BOMB), "more than the 0 bytes"),
        (claiming(1000, BOMB), "more than the 1000 bytes"),
        # Ends before it.
        (claiming(1001, bomb(1000)), "frame: "),
        # More than one member, or something behind it.
        (bomb(100) + bomb(100), "follows"),
        (bomb(100) + b"x" + bomb(100)[-8:], "follows"),
        (bomb(100) + bytes(1 << 19) + bomb(100)[-8:], "follows"),
        # Wrong checksum.
        (bomb(100)[:-8] + bytes(4) + bomb(100)[-4:], "incorrect data check"),
        # Ends inside, with a trailer where deflate would go on.
        (bomb(1 << 16)[:30] + struct.pack("<II", 0, 1 << 14), "frame: "),
        (with_name(bomb(100)), "neither a zstd frame nor a gzip member"),
        # zlib's and no container at all.
        (zlib.compress(bytes(100)), "neither"),
        (b"\x1f\x8b\x08\0", "no gzip member"),
        (gzipframe.HEAD + struct.pack("<II", 0, 0), "frame: "),
    ],
)
def test_frames_that_are_refused_before_they_grow(frame: bytes, says: str) -> None:
    tracemalloc.start()
    with pytest.raises(CorruptError, match=says):
        decode_frame(frame)
    peak_bytes = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak_bytes < 3 << 20


def test_the_cap_is_that_of_the_caller() -> None:
    frame = bomb(5000)
    assert decompress(frame, 5000) == bytes(5000)
    with pytest.raises(CorruptError, match="5000 bytes of content, at most 4999"):
        decompress(frame, 4999)


def test_a_large_frame_is_held_once() -> None:
    content = random.Random(1).randbytes(1 << 22)
    frame = compress(content, (), Coder.GZIP)
    tracemalloc.start()
    found = decompress(frame, len(content))
    peak_bytes = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert found == content
    assert peak_bytes < 1.5 * len(content)


def test_what_shrinks_as_far_as_deflate_can_still_comes_back() -> None:
    content = bytes(1 << 24)
    frame = compress(content, (), Coder.GZIP)
    assert len(frame) < len(content) / 1000
    assert decompress(frame, len(content)) == content


@given(st.lists(st.binary(max_size=300), min_size=1, max_size=6))
@settings(max_examples=60, deadline=None)
def test_the_coder_keeps_content_wherever_blocks_end(planes: list[bytes]) -> None:
    content = b"".join(planes)
    edges = [0, *np.cumsum([len(plane) for plane in planes]).tolist()]
    for frame in (compress(content, edges, Coder.GZIP), compress(content, (), Coder.GZIP)):
        assert decompress(frame, len(content)) == content == gzip.decompress(frame)


def test_ending_blocks_between_planes_makes_gzip_as_small_as_zstd() -> None:
    chunk = encode_chunk(trained_like_slice(0, 4000), 0, Profile.COMPACT)
    frame = encode_frame(chunk, Coder.GZIP)
    assert len(frame) < 0.95 * len(gzip.compress(chunk, 9))
    assert len(frame) < 1.02 * len(encode_frame(chunk))


# What a browser has, and no code of ours: fetch, DataView, DecompressionStream.
SCRIPT = """
const data = require("fs").readFileSync(process.argv[1]);
const view = new DataView(data.buffer, data.byteOffset, data.length);
async function main() {
  const chunks = [];
  for (let n = 0; n < view.getUint32(16, true); n++) {
    const offset = view.getUint32(24 + 12 * n, true), size = view.getUint32(28 + 12 * n, true);
    const frame = new Blob([data.subarray(offset, offset + size)]);
    const inflated = frame.stream().pipeThrough(new DecompressionStream("gzip"));
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
    assert json.loads(done.stdout) == [chunk.hex() for chunk in chunks]
