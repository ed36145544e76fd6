"""Hostile chunks for tests/support/bounded_decoder.py, with the declared bytes of each."""

from __future__ import annotations

import os
import struct
import tempfile
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import zstandard

from codec.coders.coder import decompress
from codec.lattice.lattice import Lattice
from codec.slots.mask import MaskHistory, decode_mask
from codec.slots.slotchange import COUNTS, decode_change
from codec.slots.slotchunk import SLOT_HEADER, Kind
from codec.slots.slotlayout import SlotLayout
from codec.slots.snapshot import decode_snapshot
from codec.slots.update import Update
from codec.stream import StreamReader, StreamWriter
from codec.stream.index import pack_record
from codec.stream.manifest import MASKS, Part, is_snapshot, snapshot_part
from codec.tools.audit import verify_stream
from tests.support.hostile import put_packets
from tests.support.slots.folder import slots_manifest, write_slots

N = 1 << 18
"""Number of slots in a lane."""

LATTICE = Lattice(0.01, 0.125, 1 / 60, 0.056, 41)
LAYOUT = SlotLayout(1, (N,), 0, (LATTICE,), 4)
LANES = SlotLayout(4, (N // 4,), 0, (LATTICE,), 4)
DEGREE_3 = SlotLayout(1, (N,), 3, (LATTICE,), 4)

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
    """A change with N new Gaussians that all escape, to the origin."""
    k = (sh_degree + 1) ** 2
    one = struct.pack("<f", 1.0)
    floats = bytes(24 * N) + one * (4 * N) + bytes(4 * N * (1 + 3 * k))
    numbers = struct.pack(f"<{N}I", *range(N))
    body = COUNTS.pack(0, N, 0, N, 0) + bytes((10 + 3 * k) * N) + numbers + floats
    return compress(head(Kind.CHANGE, 5) + body)


def read_change(layout: SlotLayout, packet: bytes, new: int) -> None:
    decode_change(layout, 0, 5, decompress(packet, layout.max_change_bytes(0)), 0, new)


def full_snapshot() -> bytes:
    """A snapshot of N Gaussians at the origin."""
    flags = b"\xff" * (N // 8)
    body = COUNTS.pack(0, N, 0, 0, 0) + bytes(13 * N)
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
    """Plays a stream of N slots, nearly all of them empty."""
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
    """A mask whose content is 4 * N bytes of `body`."""
    outcome = "CorruptError: mask: a body of 1048576 bytes, of which"
    return lambda: compress(head(Kind.MASK, 5) + body(4 * N)), read_mask, N * (4 + 2), outcome


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
        lambda data: read_change(DEGREE_3, data, N),
        # The content, the state, the floats and a copy of them.
        N * (58 + 4 + 236) + N * (12 + 55 + 2 * 236),
        "value",
    ),
    "change that no mask names": (
        lambda: escaped_change(0),
        lambda data: read_change(LAYOUT, data, 7),
        N * (13 + 4 + FLOAT_BYTES),
        "CorruptError: change: 262144 new, the mask declares 7",
    ),
    "full snapshot": (full_snapshot, read_snapshot, N * (13 + 3 * STATE_BYTES), "value"),
    "mask of zeros": mask_of(bytes),
    "mask of noise": mask_of(os.urandom),
    "mask beyond its slots": beyond(Kind.MASK, 1, MASKS, "segments/0/masks: byte 3303"),
    "change beyond its slots": beyond(Kind.CHANGE, 1, 1, "segments/0/1: byte 3303"),
    "snapshot beyond its slots": beyond(Kind.SNAPSHOT, 0, snapshot_part(0), "snapshot-0: byte 32"),
    "verify beyond its slots": beyond(Kind.CHANGE, 1, 0, "segments/0/0: byte 68", verify_stream),
    "sizes in an index": (lambda: b"", lying_sizes, 0, "bytes, the index says 1073741824"),
    "empty slots": (lambda: b"", empty_slots, N * 4 * (STATE_BYTES + FLOAT_BYTES), "value"),
}
