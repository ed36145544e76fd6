"""Hostile bytes under a memory limit that the kernel enforces: no decoder exceeds the claim.

This module run as a program makes a fork for each case. The fork gets the hostile input, reads its
data memory (VmData, with the allocations of zstd and numpy), limits itself to the declared bytes
plus SLACK_BYTES, and decodes. Declared bytes are, within the caps of the format, the content bytes
that a header claims plus the bytes of its claimed Gaussians as float32. A claim over a cap declares
nothing: it must be refused before it costs memory.
"""

from __future__ import annotations

import gzip
import json
import os
import resource
import struct
import subprocess
import sys
import tempfile
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import msgpack
import pytest
import zstandard

from codec.coders.zstd import decompress
from codec.interop.formats import decode_any
from codec.lattice.lattice import Lattice
from codec.slots.change import COUNTS, decode_change
from codec.slots.changepacket import FORM, sealed
from codec.slots.skipmap import SkipMapHistory, decode_skip_map
from codec.slots.slotlayout import SLOT_HEADER, Kind, SlotLayout, Update
from codec.slots.state import decode_keyframe
from codec.stream import StreamReader, StreamWriter
from codec.stream.manifest import Manifest
from codec.stream.playrecord import LENGTH, MAX_RECORD_BYTES, RecordParser
from codec.stream.segment import OBJECT_HEAD, pack_record, packet_content
from codec.tools.audit import verify_stream
from tests.support.commands import ROOT
from tests.support.hostile import put_packets
from tests.support.objects import object_packets
from tests.support.slots.folder import slots_manifest, write_slots
from tests.support.tiny_stream import tiny_manifest

SLOTS = 1 << 18
"""Number of slots in a lane."""
LATTICE = Lattice(0.01, 0.125, 1 / 60, 0.056, 41)
LAYOUT = SlotLayout(1, (SLOTS,), 0, (LATTICE,), 4)
LANES = SlotLayout(4, (SLOTS // 4,), 0, (LATTICE,), 4)
DEGREE_3 = SlotLayout(1, (SLOTS,), 3, (LATTICE,), 4)
STATE_BYTES, FLOAT_BYTES = 12 + 10 + 2, 56
"""Bytes of a slot of SH degree 0 as integers, and as float32."""
SLACK_BYTES = 64 << 20
MOST = 80 << 20
"""Largest content of a packet here; more than SLACK_BYTES, so that a copy of it is noticed."""

Case = tuple[Callable[[], bytes], Callable[[bytes], object], int, str]
"""A hostile input, a decoder for it, the declared bytes of the input, and `value` or a part of the
error. A failed allocation inside zstd gives neither."""


def compress(content: bytes) -> bytes:
    return zstandard.ZstdCompressor(level=1, write_checksum=True).compress(content)


def head(kind: Kind, birth: int) -> bytes:
    return SLOT_HEADER.pack(b"SWG1", kind, 0, 0, 0, birth)


def escaped_change() -> bytes:
    """A change of SH degree 3 with SLOTS new Gaussians that all escape, to the origin."""
    floats = bytes(24 * SLOTS) + struct.pack("<f", 1.0) * (4 * SLOTS) + bytes(4 * SLOTS * 49)
    numbers = struct.pack(f"<{SLOTS}I", *range(SLOTS))
    body = COUNTS.pack(0, SLOTS, 0, SLOTS, 0) + bytes(58 * SLOTS) + numbers + floats
    return compress(head(Kind.CHANGE, 5) + body)


def coded_change() -> bytes:
    """A packet of coded planes whose predicted Gaussians all stay as they were, without a bit."""
    count = (MOST - 4096) // 13
    bits = count.bit_length()
    numbers = bits | count << 5
    at = 5 + bits + 10
    for num_planes in (4, 3, 3, 3):
        numbers |= 1 << at
        at += 3 << num_planes
    body = numbers.to_bytes((at + 7) // 8, "little") + bytes(MOST // 30_000)
    return sealed(bytes([FORM, 0, 0, 0]) + bytes(4) + body)


def read_change(packet: bytes) -> None:
    content = decompress(packet, DEGREE_3.max_change_bytes(0))
    decode_change(DEGREE_3, 0, 5, content, 0, SLOTS)


def full_keyframe() -> bytes:
    """A keyframe of SLOTS Gaussians at the origin."""
    body = b"\xff" * (SLOTS // 8) + COUNTS.pack(0, SLOTS, 0, 0, 0) + bytes(13 * SLOTS)
    return compress(head(Kind.KEYFRAME, 4) + body)


def read_keyframe(packet: bytes) -> None:
    decode_keyframe(LANES, decompress(packet, LANES.max_keyframe_bytes(0)))


def read_skip_map(packet: bytes) -> None:
    data = decompress(packet, LAYOUT.max_skip_map_bytes)
    decode_skip_map(LAYOUT, 5, data, SkipMapHistory(LAYOUT).of(5))


def in_a_stream(read: Callable[[Path, bytes], object]) -> Callable[[bytes], object]:
    """Gives `read` a stream of 15 slots, too."""

    def decode(data: bytes) -> None:
        with tempfile.TemporaryDirectory() as folder:
            write_slots(Path(folder) / "stream", 4)
            read(Path(folder) / "stream", data)

    return decode


def read_beyond(path: Path, packet: bytes) -> None:
    put_packets(path, 0, 0, [(birth, packet) for birth in range(4)])
    StreamReader(path).window(3, 2)


def lying_sizes(path: Path, _: bytes) -> None:
    """Reads a stream whose index claims a gigabyte for every object."""
    record = StreamReader(path).records[0]
    record = replace(record, object_bytes=(1 << 30,) * 2, side_bytes=(1 << 30,) * 3)
    (path / "index.bin").write_bytes(pack_record(record))
    StreamReader(path).window(3, 2)


def sparse_index(path: Path, _: bytes) -> None:
    """Opens a stream with a sparse index of 64 GB."""
    os.truncate(path / "index.bin", 64 << 30)
    StreamReader(path)


def empty_slots(path: Path, _: bytes) -> None:
    """Plays a stream of SLOTS slots, nearly all of them empty."""
    path = path.with_name("empty")
    with StreamWriter.create(path, slots_manifest(LANES)) as writer:
        for birth in range(-3, 6):
            writer.append(Update.keeping(birth, LANES))
    verify_stream(path)
    StreamReader(path).active_splats(5, 1)


def read_packet(packet: bytes) -> bytes:
    return packet_content(packet, MOST)


def claiming(size: int) -> bytes:
    """The first 8 KB of a packet that claims a content of `size` bytes."""
    compressor = zstandard.ZstdCompressor(write_checksum=True).compressobj(size)
    packet = compressor.compress(os.urandom(8192))
    return packet + compressor.flush(zstandard.COMPRESSOBJ_FLUSH_BLOCK)


def lying_table() -> bytes:
    """A table of the maximum number of chunks, each claiming 65000 bytes; there are no chunks."""
    count = 1 << 14
    end = OBJECT_HEAD.size + 12 * count
    data = OBJECT_HEAD.pack(0x184D2A50, end - 8, b"SWGO", 1, 2, 0, count)
    return data + b"".join(struct.pack("<iII", n, end + n * 65000, 65000) for n in range(count))


def keyframe_record() -> bytes:
    value = {"kind": "keyframe", "frame": 0, "first": 0, "packets": [bytes(4_000_000)] * 16}
    body: bytes = msgpack.packb(value)
    return LENGTH.pack(len(body)) + body


def spz_4() -> bytes:
    """An SPZ whose header and table claim 40 Gaussians; each array inflates to 100 MB."""
    frame = zstandard.ZstdCompressor(level=1, write_content_size=False).compress(bytes(100 << 20))
    said = struct.pack("<4sIIBBBBI12x", b"NGSP", 4, 40, 0, 12, 0, 5, 32)
    table = b"".join(struct.pack("<QQ", len(frame), 40 * row) for row in (9, 1, 3, 3, 4))
    return said + table + frame * 5


def read_splat(data: bytes) -> None:
    decode_any(data, ".splat")


CASES: dict[str, Case] = {
    "escapes": (
        escaped_change,
        read_change,
        # The content, the state, the floats and a copy of them.
        SLOTS * (58 + 4 + 236) + SLOTS * (12 + 55 + 2 * 236),
        "value",
    ),
    "keyframe": (full_keyframe, read_keyframe, SLOTS * (13 + 3 * STATE_BYTES), "value"),
    "skip_map": (
        lambda: compress(head(Kind.SKIP_MAP, 5) + bytes(4 * SLOTS)),
        read_skip_map,
        SLOTS * (4 + 2),
        "CorruptError: skip map: a body of 1048576 bytes, of which",
    ),
    "beyond its slots": (
        lambda: compress(head(Kind.CHANGE, 1) + bytes(100 << 20)),
        in_a_stream(read_beyond),
        0,
        "segments/0/0: byte 3303: packet: 104857612 bytes of content",
    ),
    "sizes": (bytes, in_a_stream(lying_sizes), 0, "bytes, the index says 1073741824"),
    "index": (bytes, in_a_stream(sparse_index), 0, "index.bin is longer than"),
    "empty": (bytes, in_a_stream(empty_slots), SLOTS * 4 * (STATE_BYTES + FLOAT_BYTES), "value"),
    "zstd": (lambda: compress(bytes(MOST)), read_packet, MOST, "value"),
    # The planes, the chunk, and of each Gaussian its pattern, its place and a value.
    "coded": (coded_change, read_packet, 2 * MOST + MOST // 13 * 17, "value"),
    "zstd claims": (lambda: claiming(MOST + 1), read_packet, 0, f"at most {MOST}"),
    "table": (lying_table, object_packets, 0, "196628 bytes, its table says 1065156628"),
    "manifest": (
        lambda: b"[" + b"[]," * 349_000 + b"1]",
        Manifest.from_json,
        0,
        "CorruptError: manifest: is not a JSON object",
    ),
    "texts in a manifest": (
        lambda: tiny_manifest().to_json().replace(b"front", "\U0001f600".encode() * 60_000),
        Manifest.from_json,
        0,
        "a name of 60000 characters, at most 2000",
    ),
    # As received, and as decoded.
    "record": (keyframe_record, RecordParser().feed, 2 * MAX_RECORD_BYTES, "value"),
    "splat": (lambda: bytes(32 << 21), read_splat, FLOAT_BYTES << 21, "value"),
    "spz": (spz_4, decode_any, 0, "SPZ: an array: decompression error: did not decompress full"),
    "spz, gzip": (
        lambda: gzip.compress(struct.pack("<4sIIBBBB", b"NGSP", 3, 2, 0, 12, 0, 0) + bytes(MOST)),
        decode_any,
        0,
        "SPZ: not the 40 bytes that 2 Gaussians need",
    ),
    "spz claims": (lambda: spz_4()[:8] + b"\0\0\0\1" + spz_4()[12:], decode_any, 0, "claims to"),
    # The limit is effective.
    "control": (bytes, lambda _: bytearray(2 * SLACK_BYTES), 0, "MemoryError"),
}


def elsewhere(make: Callable[[], bytes]) -> bytes:
    """What `make` gives in a fork, so that its memory is not left in this process."""
    with tempfile.TemporaryFile() as file:
        pid = os.fork()
        if not pid:
            file.write(make())
            file.flush()
            os._exit(0)
        if status := os.waitpid(pid, 0)[1]:
            return b"ended with %d" % os.waitstatus_to_exitcode(status)
        file.seek(0)
        return file.read()


def outcome(case: Case) -> bytes:
    """Outcome of decoding in this process, whose memory is limited from now on."""
    make, decode, declared_bytes, _ = case
    food = elsewhere(make)
    status = Path("/proc/self/status").read_text(encoding="utf-8")
    used_bytes = int(status.partition("VmData:")[2].split()[0]) << 10
    resource.setrlimit(resource.RLIMIT_DATA, (used_bytes + declared_bytes + SLACK_BYTES,) * 2)
    try:
        decode(food)
        return b"value"
    except Exception as error:
        return f"{type(error).__name__}: {str(error)[:300]}".encode()


def main() -> None:
    # The memory of kernels and of loading them is not part of decoding an input.
    with tempfile.TemporaryDirectory() as folder:
        write_slots(Path(folder) / "stream", 6)
        verify_stream(Path(folder) / "stream")
        StreamReader(Path(folder) / "stream").active_splats(5, 2)
    found = {name: elsewhere(lambda case=case: outcome(case)) for name, case in CASES.items()}  # type: ignore[misc]
    json.dump({name: told.decode() for name, told in found.items()}, sys.stdout)


@pytest.mark.skipif(not Path("/proc/self/status").exists(), reason="needs Linux: VmData")
def test_memory_stays_within_what_is_declared() -> None:
    done = subprocess.run(
        [sys.executable, "-m", "tests.codec.stream.test_memory"],
        cwd=ROOT,
        env={**os.environ, "OPENBLAS_NUM_THREADS": "1"},
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done.stderr[-2000:]
    found: dict[str, str] = json.loads(done.stdout)
    wanted = {name: case[3] for name, case in CASES.items()}
    wrong = {
        name: told
        for name, told in found.items()
        if wanted[name] not in told or (told == "value") != (wanted[name] == "value")
    }
    assert wrong == {}
    assert len(found) == len(CASES)


if __name__ == "__main__":
    main()
