"""A decoder with a memory limit.

It is a process, `python -m tests.support.bounded_decoder`, with a fork for each case. The fork gets
the hostile input, reads its data memory (VmData, with the allocations of zstd and numpy), limits
itself to the declared bytes plus SLACK_BYTES, and decodes. The process prints all outcomes as JSON.

Declared bytes are, within the caps of the format, the content bytes that a header claims plus the
bytes of its claimed Gaussians as float32. A claim over a cap declares nothing: it must be refused
before it costs memory.
"""

from __future__ import annotations

import gzip
import json
import os
import resource
import struct
import sys
import tempfile
import zlib
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import msgpack
import zstandard

from codec.interop.formats import decode_any, read_splats
from codec.stream.manifest import Manifest
from codec.stream.object import HEAD, packet_content
from codec.stream.playrecord import LENGTH, MAX_RECORD_BYTES, RecordParser
from codec.stream.reader import StreamReader
from tests.support.objects import object_packets
from tests.support.slots.bounded_slots import SLOT_CASES, compress, warm
from tests.support.tiny_stream import tiny_manifest, write_tiny

SLACK_BYTES = 64 << 20
MOST = 80 << 20
"""Largest content of a packet here; more than SLACK_BYTES, so that a copy of it is noticed."""
N = 1 << 20
VALUE_BYTES = 236
"""Bytes of a Gaussian of SH degree 3 as float32."""


@dataclass(frozen=True, slots=True)
class Case:
    """A hostile input, a decoder for it, and the declared bytes of the input."""

    make: Callable[[], bytes]
    decode: Callable[[bytes], object]
    declared_bytes: int
    outcome: str = "value"
    """`value`, or a part of the error. A failed allocation inside zstd gives neither."""


def gzip_member(content: bytes, said_bytes: int) -> bytes:
    """`content` as a gzip member whose trailer claims `said_bytes`."""
    stream = zlib.compressobj(1, zlib.DEFLATED, -zlib.MAX_WBITS)
    body = stream.compress(content) + stream.flush()
    head = b"\x1f\x8b\x08\x00" + bytes(4) + b"\x02\xff"
    return head + body + struct.pack("<II", zlib.crc32(content), said_bytes)


def content(packet: bytes) -> bytes:
    return packet_content(packet, MOST)


def claiming(size: int) -> bytes:
    """The first 8 KB of a packet that claims a content of `size` bytes."""
    compressor = zstandard.ZstdCompressor(write_checksum=True).compressobj(size)
    packet = compressor.compress(os.urandom(8192))
    return packet + compressor.flush(zstandard.COMPRESSOBJ_FLUSH_BLOCK)


def lying_table() -> bytes:
    """A table of the maximum number of chunks, each claiming 65000 bytes; there are no chunks."""
    count = 1 << 14
    end = HEAD.size + 12 * count
    data = HEAD.pack(0x184D2A50, end - 8, b"SWGO", 2, 1, 0, count)
    return data + b"".join(struct.pack("<iII", n, end + n * 65000, 65000) for n in range(count))


def sparse_index(_: bytes) -> None:
    """Opens a stream with a sparse index of 64 GB."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "stream"
        write_tiny(path, 4)
        os.truncate(path / "index.bin", 64 << 30)
        StreamReader(path)


def record(value: object) -> bytes:
    body: bytes = msgpack.packb(value)
    assert len(body) <= MAX_RECORD_BYTES
    return LENGTH.pack(len(body)) + body


def spz_4(raw_bytes: int) -> bytes:
    """An SPZ whose header and table claim 40 Gaussians; each array inflates to `raw_bytes`."""
    streaming = zstandard.ZstdCompressor(level=1, write_content_size=False)
    frame = streaming.compress(bytes(raw_bytes))
    head = struct.pack("<4sIIBBBBI12x", b"NGSP", 4, 40, 0, 12, 0, 5, 32)
    table = b"".join(struct.pack("<QQ", len(frame), 40 * row) for row in (9, 1, 3, 3, 4))
    return head + table + frame * 5


def read_short_file(data: bytes) -> None:
    """Reads a file of Gaussians; such files may have up to 4 GB."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "short.splat"
        path.write_bytes(data)
        read_splats(path)


def ply_claiming(count: int) -> bytes:
    names = ["x", "y", "z", *(f"f_dc_{i}" for i in range(3)), "opacity"]
    names += [f"scale_{i}" for i in range(3)] + [f"rot_{i}" for i in range(4)]
    lines = ["ply", "format binary_little_endian 1.0", f"element vertex {count}"]
    return "\n".join([*lines, *(f"property float {n}" for n in names), "end_header\n"]).encode()


def ply_of_floats(sh_degree: int) -> bytes:
    """A PLY of N Gaussians in which every number is 1."""
    rest = 3 * ((sh_degree + 1) ** 2 - 1)
    head = ply_claiming(N)
    extra = "".join(f"property float f_rest_{i}\n" for i in range(rest)).encode()
    head = head.replace(b"end_header\n", extra + b"end_header\n")
    return head + struct.pack("<f", 1.0) * ((14 + rest) * N)


def compressed_ply(count: int) -> bytes:
    num_chunks = -(-count // 256)
    lines = ["ply", "format binary_little_endian 1.0", f"element chunk {num_chunks}"]
    for what in ("", "scale_"):
        lines += [f"property float {end}_{what}{c}" for end in ("min", "max") for c in "xyz"]
    lines += [f"property float {end}_{c}" for end in ("min", "max") for c in "rgb"]
    lines += [f"element vertex {count}"]
    lines += [f"property uint packed_{n}" for n in ("position", "rotation", "scale", "color")]
    head = "\n".join([*lines, "end_header\n"]).encode()
    return head + bytes(18 * 4 * num_chunks) + bytes(16 * count)


def spz_3(count: int) -> bytes:
    head = struct.pack("<4sIIBBBB", b"NGSP", 3, count, 0, 12, 0, 0)
    # Random bytes, because zeros alone would make it a bomb.
    return gzip.compress(head + os.urandom(count) + bytes(19 * count), 1)


def spz_bomb() -> bytes:
    return gzip.compress(struct.pack("<4sIIBBBB", b"NGSP", 2, 9, 0, 12, 0, 0) + bytes(99 << 20), 1)


RECORDS_BYTES = 2 * MAX_RECORD_BYTES
"""Bytes of a record as received, and as decoded."""

HALF = "CorruptError: packet: decompression error: did not decompress full frame"
TOO_MUCH = f"{MOST + 1} bytes of content, at most {MOST}"


def feed(data: bytes) -> object:
    return RecordParser().feed(data)


CASES: dict[str, Case] = {
    "zstd": Case(lambda: compress(bytes(MOST)), content, MOST),
    "cut off": Case(lambda: compress(bytes(MOST))[:-9], content, MOST, HALF),
    "claims the most": Case(lambda: claiming(MOST), content, MOST, HALF),
    "claims too much": Case(lambda: claiming(MOST + 1), content, 0, TOO_MUCH),
    "claims an exabyte": Case(
        lambda: claiming(1 << 60), content, 0, f"{1 << 60} bytes of content cannot come from 8"
    ),
    "gzip": Case(lambda: gzip_member(bytes(MOST), MOST), content, MOST),
    "gzip says less": Case(
        lambda: gzip_member(bytes(100 << 20), 1000),
        content,
        0,
        "CorruptError: packet: more content than the 1000 bytes that it declares",
    ),
    "gzip claims too much": Case(lambda: gzip_member(bytes(MOST), MOST + 1), content, 0, TOO_MUCH),
    "table": Case(
        lying_table,
        object_packets,
        0,
        "CorruptError: object: 196628 bytes, its table says 1065156628",
    ),
    "index": Case(lambda: b"", sparse_index, 0, "index.bin is longer than"),
    "manifest": Case(
        lambda: b"[" + b"[]," * 349_000 + b"1]",
        Manifest.from_json,
        0,
        "CorruptError: manifest: is not a JSON object",
    ),
    "texts in a manifest": Case(
        lambda: tiny_manifest().to_json().replace(b"front", "\U0001f600".encode() * 60_000),
        Manifest.from_json,
        0,
        "a name of 60000 characters, at most 2000",
    ),
    "snapshot record": Case(
        lambda: record(
            {"kind": "snapshot", "frame": 0, "first": 0, "packets": [bytes(4_000_000)] * 16}
        ),
        feed,
        RECORDS_BYTES,
    ),
    "bytes as a kind": Case(
        lambda: record({"kind": bytes(64_000_000)}),
        feed,
        RECORDS_BYTES,
        "CorruptError: play: a record of kind bytes",
    ),
    "text in a record": Case(
        lambda: record({"kind": "error", "message": "\U0001f600" + "x" * 64_000_000}),
        feed,
        RECORDS_BYTES,
        "CorruptError: play: a record is not msgpack",
    ),
    "short file": Case(lambda: bytes(28) + b"\xff" * 4, read_short_file, 0),
    "ply": Case(lambda: ply_claiming(1 << 24), decode_any, 0, "CorruptError: PLY: ends after"),
    "ply over the cap": Case(
        lambda: ply_claiming(1 << 40), decode_any, 0, f"CorruptError: PLY: claims {1 << 40} Gaus"
    ),
    "spz": Case(
        spz_bomb, decode_any, 0, "CorruptError: SPZ: not the 171 bytes that 9 Gaussians need"
    ),
    "ply of degree 3": Case(lambda: ply_of_floats(3), decode_any, N * VALUE_BYTES),
    "compressed ply": Case(lambda: compressed_ply(2 * N), decode_any, 2 * N * 56),
    "splat": Case(lambda: bytes(32) * 2 * N, lambda data: decode_any(data, ".splat"), 2 * N * 56),
    "spz 3": Case(lambda: spz_3(2 * N), decode_any, 2 * N * (20 + 56)),
    "spz 4": Case(
        lambda: spz_4(100 << 20),
        decode_any,
        0,
        "CorruptError: SPZ: an array: decompression error: did not decompress full frame",
    ),
    **{name: Case(*hostile) for name, hostile in SLOT_CASES.items()},
    # The limit is effective.
    "control": Case(lambda: b"", lambda _: bytearray(SLACK_BYTES + (1 << 20)), 0, "MemoryError"),
}


def data_bytes() -> int:
    """VmData of this process."""
    for line in Path("/proc/self/status").read_text(encoding="utf-8").splitlines():
        if line.startswith("VmData:"):
            return int(line.split()[1]) << 10
    raise RuntimeError("no VmData in /proc/self/status")


def made_elsewhere(case: Case) -> bytes:
    """The input of `case`, generated in a fork, so that its memory is not left in this process."""
    with tempfile.TemporaryFile() as file:
        pid = os.fork()
        if not pid:
            file.write(case.make())
            file.flush()
            os._exit(0)
        if os.waitpid(pid, 0)[1]:
            raise RuntimeError("the input could not be made")
        file.seek(0)
        return file.read()


def decode(case: Case) -> str:
    """Outcome of decoding in this process, whose memory is limited from now on."""
    food = made_elsewhere(case)
    limit = data_bytes() + case.declared_bytes + SLACK_BYTES
    resource.setrlimit(resource.RLIMIT_DATA, (limit, limit))
    try:
        case.decode(food)
        return "value"
    except Exception as error:
        return f"{type(error).__name__}: {str(error)[:300]}"


def decoded_elsewhere(case: Case) -> str:
    """Outcome of decoding in a fork."""
    with tempfile.TemporaryFile() as file:
        pid = os.fork()
        if not pid:
            os.write(file.fileno(), decode(case).encode())
            os._exit(0)
        if status := os.waitpid(pid, 0)[1]:
            return f"ended with {os.waitstatus_to_exitcode(status)}"
        file.seek(0)
        return file.read().decode()


def main() -> None:
    # The memory of kernels and of loading them is not part of decoding an input.
    warm()
    json.dump({name: decoded_elsewhere(case) for name, case in CASES.items()}, sys.stdout)


if __name__ == "__main__":
    main()
