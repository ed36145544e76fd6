"""A stream of a few kilobytes whose manifest is legal and asks for 2^24 Gaussians."""

from __future__ import annotations

import hashlib
from pathlib import Path

import numpy as np
import zstandard

from codec.lattice.lattice import Lattice
from codec.slots.change import COUNTS
from codec.slots.slotlayout import SLOT_HEADER, Kind, SlotLayout
from codec.stream.segment import SegmentRecord, join_packets, pack_record
from tests.support.slots.folder import slots_manifest

LANES, SLOTS = 16, 1 << 20
NUM_GAUSSIANS = LANES * SLOTS

_LAYOUT = SlotLayout(LANES, (SLOTS,), 0, (Lattice(0.01, 0.125, 1 / 60, 0.056, 41),), 1)


def _keyframe() -> bytes:
    """All Gaussians at the origin, all bytes 0: 220 MB of content as a packet."""
    head = SLOT_HEADER.pack(b"SWG1", Kind.KEYFRAME, 0, 0, 0, 0) + b"\xff" * (NUM_GAUSSIANS // 8)
    head += COUNTS.pack(0, NUM_GAUSSIANS, 0, 0, 0)
    planes, piece = 13 * NUM_GAUSSIANS, bytes(1 << 20)
    coder = zstandard.ZstdCompressor(level=1, write_checksum=True)
    coding = coder.compressobj(size=len(head) + planes)
    packet = coding.compress(head)
    for _ in range(planes // len(piece)):
        packet += coding.compress(piece)
    return packet + coding.flush()


def write_many(stream: Path) -> None:
    """Writes the stream: one frame, one layer, one keyframe of NUM_GAUSSIANS."""
    objects = [join_packets([(0, packet)]) for packet in (b"", b"", _keyframe())]
    folder = stream / "segments" / "0"
    folder.mkdir(parents=True)
    for name, data in zip(("0", "skipmaps", "keyframe-0"), objects, strict=True):
        (folder / name).write_bytes(data)
    sizes = tuple(map(len, objects))
    hashes = tuple(hashlib.sha256(data).digest() for data in objects)
    record = SegmentRecord(
        0, 0, 1, sizes[:1], hashes[:1], (np.nan,), side_bytes=sizes[1:], side_sha256=hashes[1:]
    )
    (stream / "index.bin").write_bytes(pack_record(record))
    manifest = slots_manifest(_LAYOUT).with_live(False)
    (stream / "manifest.json").write_bytes(manifest.to_json())
