"""What one fetches who plays a stream from frame 0, or joins it later: bytes, and Gaussians."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from codec.slots.mask import MaskHistory, decode_mask
from codec.slots.snapshot import decode_snapshot
from codec.slots.update import PREDICTED
from codec.stream import StreamReader
from codec.stream.manifest import MASKS, snapshot_part


@dataclass(frozen=True, slots=True)
class Traffic:
    """Of one number of layers."""

    object_bytes: int
    """Of the objects that one fetches who plays from frame 0."""
    gaussians: int
    """What those objects bring: the Gaussians of frame 0, and all that a later slice sends,
    whether new or changed. In version 1 what all slices hold at full count."""
    join_bytes: int
    """Of the snapshots that only those fetch who join later, or take up a layer again."""


def traffic(reader: StreamReader) -> list[Traffic]:
    """Of 1, 2, ... layers. Raises a CodecError that names the object at fault."""
    manifest, records = reader.manifest, reader.records
    layers = range(1, manifest.num_layers + 1)
    if not manifest.has_slots:
        slices = reader.num_frames + manifest.swin_size - 1
        shares = [sum(manifest.layers[:n]) for n in layers]
        return [
            Traffic(
                sum(sum(record.object_bytes[:n]) for record in records),
                round(slices * manifest.slice_size * share),
                0,
            )
            for n, share in zip(layers, shares, strict=True)
        ]
    brought = np.cumsum(_brought(reader))
    found = []
    for n in layers:
        played = sum(sum(record.object_bytes[:n]) + record.side_bytes[0] for record in records)
        snapshots = [sum(record.side_bytes[1 : n + 1]) for record in records]
        found.append(Traffic(played + sum(snapshots[:1]), int(brought[n - 1]), sum(snapshots[1:])))
    return found


def _brought(reader: StreamReader) -> list[int]:
    """How many Gaussians each layer of a stream of version 2 brings to one who plays it."""
    layout = reader.manifest.slot_layout
    edges = layout.row_edges
    counts = []
    for layer in range(layout.num_layers):
        snapshot = decode_snapshot(layout, reader.read_object(0, snapshot_part(layer)).content(0))
        counts.append(sum(len(slots.newcomers()) for slots in snapshot.lanes))
    history = MaskHistory(layout)
    for record in reader.records:
        masks = reader.read_object(record.segment, MASKS)
        for birth in range(record.first_frame, record.first_frame + record.num_frames):
            statuses = decode_mask(layout, birth, masks.content(birth), history.of(birth))
            history.note(birth, statuses)
            is_sent = statuses >= PREDICTED
            for layer in range(layout.num_layers):
                counts[layer] += int(is_sent[edges[layer] : edges[layer + 1]].sum())
    return counts
