"""What one fetches who plays a stream from frame 0, or joins it later: bytes, and Gaussians."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from codec.stream import StreamReader
from codec.tools.slotcensus import count_slots


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
    brought = np.cumsum(count_slots(reader).brought)
    found = []
    for n in layers:
        played = sum(sum(record.object_bytes[:n]) + record.side_bytes[0] for record in records)
        snapshots = [sum(record.side_bytes[1 : n + 1]) for record in records]
        found.append(Traffic(played + sum(snapshots[:1]), int(brought[n - 1]), sum(snapshots[1:])))
    return found
