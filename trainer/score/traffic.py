"""The traffic of a player that begins at frame 0 or later: bytes, and Gaussians."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from codec.stream import StreamReader
from codec.tools.slotcensus import count_slots


@dataclass(frozen=True, slots=True)
class Traffic:
    """The traffic of a player of one number of layers."""

    object_bytes: int
    """Size of the objects that a player from frame 0 on fetches."""
    gaussians: int
    """Gaussians in those objects: those of frame 0, and all that a later slice sends,
    whether new or changed."""
    join_bytes: int
    """Size of the snapshots that a player fetches only if it joins later, or takes up a layer
    again."""


def traffic(reader: StreamReader) -> list[Traffic]:
    """The traffic of 1, 2, ... layers. Raises a CodecError that names the object at fault."""
    manifest, records = reader.manifest, reader.records
    layers = range(1, manifest.num_layers + 1)
    brought = np.cumsum(count_slots(reader).brought)
    found = []
    for n in layers:
        played = sum(sum(record.object_bytes[:n]) + record.side_bytes[0] for record in records)
        snapshots = [sum(record.side_bytes[1 : n + 1]) for record in records]
        found.append(Traffic(played + sum(snapshots[:1]), int(brought[n - 1]), sum(snapshots[1:])))
    return found
