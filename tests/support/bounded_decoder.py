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
from dataclasses import dataclass, replace
from pathlib import Path

import msgpack
import zstandard

from codec.coders.coder import decompress
from codec.interop.formats import decode_any, read_splats
from codec.lattice.lattice import Lattice
from codec.slots.mask import MaskHistory, decode_mask
from codec.slots.slotchange import COUNTS, decode_change
from codec.slots.slotchunk import SLOT_HEADER, Kind
from codec.slots.slotlayout import SlotLayout
from codec.slots.snapshot import decode_snapshot
from codec.slots.update import Update
from codec.stream import StreamReader, StreamWriter
from codec.stream.index import pack_record
from codec.stream.manifest import MASKS, Manifest, Part, is_snapshot, snapshot_part
from codec.stream.object import HEAD, packet_content
from codec.stream.playrecord import LENGTH, MAX_RECORD_BYTES, RecordParser
from codec.tools.audit import verify_stream
from tests.support.hostile import put_packets
from tests.support.objects import object_packets
from tests.support.slots.folder import slots_manifest, write_slots
from tests.support.tiny_stream import tiny_manifest, write_tiny

SLOTS = 1 << 18
"""Number of slots in a lane."""

LATTICE = Lattice(0.01, 0.125, 1 / 60, 0.056, 41)
LAYOUT = SlotLayout(1, (SLOTS,), 0, (LATTICE,), 4)
LANES = SlotLayout(4, (SLOTS // 4,), 0, (LATTICE,), 4)
DEGREE_3 = SlotLayout(1, (SLOTS,), 3, (LATTICE,), 4)

STATE_BYTES = 12 + 10 + 2
"""Bytes of a slot of SH degree 0 as integers."""

FLOAT_BYTES = 56
"""Bytes of a Gaussian of SH degree 0 as float32."""

Hostile = tuple[Callable[[], bytes], Callable[[bytes], object], int, str]
"""The fields of a `Case`."""


def compress(content: bytes) -> bytes:
    return zstandard.ZstdCompressor(level=1, write_checksum=True).compress(content)


def head(kind: Kind, birth: int, layer: int = 0) -> bytes:
    return SLOT_HEADER.pack(b"SWG2", kind, layer, 0, 0, birth)


def escaped_change(sh_degree: int) -> bytes:
    """A change with SLOTS new Gaussians that all escape, to the origin."""
    k = (sh_degree + 1) ** 2
    one = struct.pack("<f", 1.0)
    floats = bytes(24 * SLOTS) + one * (4 * SLOTS) + bytes(4 * SLOTS * (1 + 3 * k))
    numbers = struct.pack(f"<{SLOTS}I", *range(SLOTS))
    body = COUNTS.pack(0, SLOTS, 0, SLOTS, 0) + bytes((10 + 3 * k) * SLOTS) + numbers + floats
    return compress(head(Kind.CHANGE, 5) + body)


def read_change(layout: SlotLayout, packet: bytes, new: int) -> None:
    decode_change(layout, 0, 5, decompress(packet, layout.max_change_bytes(0)), 0, new)


def full_snapshot() -> bytes:
    """A snapshot of SLOTS Gaussians at the origin."""
    flags = b"\xff" * (SLOTS // 8)
    body = COUNTS.pack(0, SLOTS, 0, 0, 0) + bytes(13 * SLOTS)
    return compress(head(Kind.SNAPSHOT, 4) + flags + body)


def read_snapshot(packet: bytes) -> None:
    decode_snapshot(LANES, decompress(packet, LANES.max_snapshot_bytes(0)))


def read_mask(packet: bytes) -> None:
    data = decompress(packet, LAYOUT.max_mask_bytes)
    decode_mask(LAYOUT, 5, data, MaskHistory(LAYOUT).of(5))


def read_folder(part: Part, packet: bytes, read: Callable[[Path], object]) -> None:
    """Reads a stream of 15 slots in which `packet` replaces the packets of `part`."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "stream"
        write_slots(path, 4)
        births = range(1 if is_snapshot(part) else 4)
        put_packets(path, 0, part, [(birth, packet) for birth in births])
        read(path)


def read_last(path: Path) -> None:
    StreamReader(path).window(3, 2)


def lying_sizes(_: bytes) -> None:
    """Reads a stream whose index claims a gigabyte for every object."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "stream"
        write_slots(path, 4)
        record = replace(
            StreamReader(path).records[0], object_bytes=(1 << 30,) * 2, side_bytes=(1 << 30,) * 3
        )
        (path / "index.bin").write_bytes(pack_record(record))
        read_last(path)


def empty_slots(_: bytes) -> None:
    """Plays a stream of SLOTS slots, nearly all of them empty."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "stream"
        write_empty(path)
        verify_stream(path)
        StreamReader(path).active_splats(5, 1)


def write_empty(path: Path) -> None:
    with StreamWriter.create(path, slots_manifest(LANES)) as writer:
        for birth in range(-3, 6):
            writer.append(Update.keeping(birth, LANES))


def warm() -> None:
    """Loads the kernels, whose memory is not part of decoding an input."""
    with tempfile.TemporaryDirectory() as folder:
        write_slots(Path(folder) / "stream", 6)
        verify_stream(Path(folder) / "stream")
        StreamReader(Path(folder) / "stream").active_splats(5, 2)


def mask_of(body: Callable[[int], bytes]) -> Hostile:
    """A mask whose content is 4 * SLOTS bytes of `body`."""
    outcome = "CorruptError: mask: a body of 1048576 bytes, of which"
    return (
        lambda: compress(head(Kind.MASK, 5) + body(4 * SLOTS)),
        read_mask,
        SLOTS * (4 + 2),
        outcome,
    )


def beyond(
    kind: Kind, birth: int, part: Part, at: str, read: Callable[[Path], object] = read_last
) -> Hostile:
    """A packet of `part` that inflates to far more bytes than its slots can need."""
    return (
        lambda: compress(head(kind, birth) + bytes(100 << 20)),
        lambda data: read_folder(part, data, read),
        0,
        f"{at}: packet: 104857612 bytes of content",
    )


SLOT_CASES: dict[str, Hostile] = {
    "change, all escaped": (
        lambda: escaped_change(3),
        lambda data: read_change(DEGREE_3, data, SLOTS),
        # The content, the state, the floats and a copy of them.
        SLOTS * (58 + 4 + 236) + SLOTS * (12 + 55 + 2 * 236),
        "value",
    ),
    "change that no mask names": (
        lambda: escaped_change(0),
        lambda data: read_change(LAYOUT, data, 7),
        SLOTS * (13 + 4 + FLOAT_BYTES),
        "CorruptError: change: 262144 new, the mask declares 7",
    ),
    "full snapshot": (full_snapshot, read_snapshot, SLOTS * (13 + 3 * STATE_BYTES), "value"),
    "mask of zeros": mask_of(bytes),
    "mask of noise": mask_of(os.urandom),
    "mask beyond its slots": beyond(Kind.MASK, 1, MASKS, "segments/0/masks: byte 3303"),
    "change beyond its slots": beyond(Kind.CHANGE, 1, 1, "segments/0/1: byte 3303"),
    "snapshot beyond its slots": beyond(Kind.SNAPSHOT, 0, snapshot_part(0), "snapshot-0: byte 32"),
    "verify beyond its slots": beyond(Kind.CHANGE, 1, 0, "segments/0/0: byte 68", verify_stream),
    "sizes in an index": (lambda: b"", lying_sizes, 0, "bytes, the index says 1073741824"),
    "empty slots": (lambda: b"", empty_slots, SLOTS * 4 * (STATE_BYTES + FLOAT_BYTES), "value"),
}


SLACK_BYTES = 64 << 20
MOST = 80 << 20
"""Largest content of a packet here; more than SLACK_BYTES, so that a copy of it is noticed."""
N = 1 << 19
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
    "compressed ply": Case(lambda: compressed_ply(4 * N), decode_any, 4 * N * 56),
    "splat": Case(lambda: bytes(32) * 4 * N, lambda data: decode_any(data, ".splat"), 4 * N * 56),
    "spz 3": Case(lambda: spz_3(4 * N), decode_any, 4 * N * (20 + 56)),
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
