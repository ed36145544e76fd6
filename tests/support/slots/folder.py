"""Tiny streams of version 2 in their folder."""

from __future__ import annotations

import hashlib
from dataclasses import replace
from pathlib import Path

import numpy as np

from codec.camera import Camera
from codec.profiles.profile import Profile
from codec.slots.slotlayout import SlotLayout
from codec.slots.update import Update
from codec.stream import StreamReader, StreamWriter
from codec.stream.index import pack_record
from codec.stream.manifest import SLOTS_VERSION, Manifest
from codec.stream.object import join_packets
from tests.support.slots.updates import patternless_updates, small_layout


def slots_manifest(layout: SlotLayout | None = None) -> Manifest:
    """The manifest of a stream of `layout`; by default of two layers, windows of 3, segments of
    4."""
    layout = small_layout(3, (9, 6), 0, 4) if layout is None else layout
    return Manifest(
        fps=25.0,
        swin_size=layout.swin_size,
        num_gs=layout.swin_size * layout.num_slots,
        layers=(),
        segment_frames=layout.segment_frames,
        sh_degree=layout.sh_degree,
        profile=Profile.LATTICE,
        antialias=False,
        near_m=0.1,
        bounds=((-3.0, -3.0, -3.0), (3.0, 3.0, 3.0)),
        cameras=(Camera("front", 64, 48, 50.0, 50.0, 32.0, 24.0, np.eye(4)),),
        default_camera="front",
        live=True,
        title="slots",
        version=SLOTS_VERSION,
        slots=layout.slots,
        lattice=layout.lattices,
    )


def write_slots(
    path: Path, num_frames: int, layout: SlotLayout | None = None, seed: int = 0
) -> list[Update]:
    """A finished stream of `num_frames` frames at `path`; gives what it was made of."""
    manifest = slots_manifest(layout)
    updates = patternless_updates(manifest.slot_layout, num_frames, seed)
    with StreamWriter.create(path, manifest) as writer:
        for update in updates:
            writer.append(update)
    return updates


def put_part(
    stream: Path, segment: int, part: str, packets: list[tuple[int, bytes]] | bytes
) -> None:
    """Replaces an object, of two layers, and says so in the index, as a faulty writer would."""
    reader = StreamReader(stream)
    number = [str(p) for p in reader.manifest.parts].index(part)
    data = packets if isinstance(packets, bytes) else join_packets(packets, version=2)
    (stream / "segments" / str(segment) / part).write_bytes(data)
    records = list(reader.records)
    sizes = list(records[segment].part_bytes)
    hashes = list(records[segment].part_sha256)
    sizes[number], hashes[number] = len(data), hashlib.sha256(data).digest()
    records[segment] = replace(
        records[segment],
        object_bytes=tuple(sizes[:2]),
        object_sha256=tuple(hashes[:2]),
        side_bytes=tuple(sizes[2:]),
        side_sha256=tuple(hashes[2:]),
    )
    (stream / "index.bin").write_bytes(b"".join(map(pack_record, records)))
