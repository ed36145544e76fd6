"""Statuses of the slots in the slices of a stream, counted, and their bytes."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from codec.arrays import Longs
from codec.errors import CodecError
from codec.slots.mask import MaskHistory, decode_mask
from codec.slots.slotstate import holds
from codec.slots.snapshot import decode_snapshot
from codec.slots.update import NEW, PREDICTED
from codec.stream.manifest import MASKS, snapshot_part
from codec.stream.reader import StreamReader


@dataclass(frozen=True, slots=True)
class SlotCensus:
    """Longs of a stream of F frames and L layers."""

    statuses: Longs
    """(F, L, 4) how many slots the slice born at each frame says KEPT, ENDED, PREDICTED, NEW of."""
    first: Longs
    """(L,) Gaussians in the snapshots of frame 0."""

    @property
    def brought(self) -> Longs:
        """(L,) Gaussians sent to a player from frame 0 on: those of the first snapshots, and all
        that a slice changes or adds."""
        sent: Longs = self.statuses[:, :, [PREDICTED, NEW]].sum(axis=(0, 2))
        return self.first + sent


def count_slots(reader: StreamReader) -> SlotCensus:
    """The census of a stream, from its masks and its first snapshots. Raises a
    CodecError that names the object at fault."""
    layout = reader.manifest.slot_layout
    history = MaskHistory(layout)
    counts = np.zeros((reader.num_frames, layout.num_layers, 4), np.int64)
    for record in reader.records:
        masks = reader.read_object(record.segment, MASKS)
        for birth in range(record.first_frame, record.first_frame + record.num_frames):
            content = masks.content(birth)
            try:
                statuses = decode_mask(layout, birth, content, history.of(birth))
            except CodecError as error:
                raise masks.blamed(error, birth) from error
            history.note(birth, statuses)
            for layer, part in enumerate(np.split(statuses, layout.row_edges[1:-1])):
                counts[birth, layer] = np.bincount(part, minlength=4)
    return SlotCensus(counts, _first(reader))


def _first(reader: StreamReader) -> Longs:
    layout = reader.manifest.slot_layout
    held = np.zeros(layout.num_layers, np.int64)
    if reader.records:
        for layer in range(layout.num_layers):
            found = reader.read_object(0, snapshot_part(layer))
            content = found.content(0)
            try:
                snapshot = decode_snapshot(layout, content)
            except CodecError as error:
                raise found.blamed(error, 0) from error
            held[layer] = sum(int(holds(slots.conditions).sum()) for slots in snapshot.lanes)
    return held


@dataclass(frozen=True, slots=True)
class SlotSummary:
    """The census of slots for `swings-stream info`; the tuples have one entry for each layer.

    The means are of the slices born after frame 0, for that of frame 0 is in the snapshots.
    """

    slots: tuple[int, ...]
    """Slots of a lane."""
    kept: tuple[float, ...]
    """Slots of a slice, as a mean; the same of the next three."""
    predicted: tuple[float, ...]
    new: tuple[float, ...]
    ended: tuple[float, ...]
    mask_bytes: int
    change_bytes: tuple[int, ...]
    first_snapshot_bytes: tuple[int, ...]
    """Snapshots of frame 0, which a player from there on fetches."""
    join_snapshot_bytes: tuple[int, ...]
    """Snapshots of all later segments, which players fetch that join there."""


def summarise_slots(reader: StreamReader, census: SlotCensus) -> SlotSummary:
    records, num_layers = reader.records, reader.manifest.num_layers
    later = census.statuses[1:]
    means = later.sum(axis=0) / max(len(later), 1)
    changes = np.array([r.object_bytes for r in records], np.int64).reshape(-1, num_layers)
    sides = np.array([r.side_bytes for r in records], np.int64).reshape(-1, num_layers + 1)
    kept, ended, predicted, new = (tuple(of_status) for of_status in means.T.tolist())
    return SlotSummary(
        reader.manifest.slots,
        kept,
        predicted,
        new,
        ended,
        int(sides[:, 0].sum()),
        tuple(changes.sum(axis=0).tolist()),
        tuple(sides[:1, 1:].sum(axis=0).tolist()),
        tuple(sides[1:, 1:].sum(axis=0).tolist()),
    )


def describe_slots(summary: SlotSummary) -> list[str]:
    """Lines for people."""
    s = summary
    named = ("kept", s.kept), ("predicted", s.predicted), ("new", s.new), ("ended", s.ended)
    means = ", ".join(f"{sum(values):.1f} {name}" for name, values in named)
    lines = [f"slots        {sum(s.slots)} a slice; as a mean {means}"]
    lines.append(f"masks        {s.mask_bytes:>12} bytes")
    for layer, count in enumerate(s.slots):
        lines.append(
            f"changes {layer:<2}   {s.change_bytes[layer]:>12} bytes; of {count} slots "
            f"{s.predicted[layer]:.1f} predicted, {s.new[layer]:.1f} new"
        )
    for layer, size in enumerate(s.first_snapshot_bytes):
        joins = s.join_snapshot_bytes[layer]
        lines.append(
            f"snapshots {layer:<2} {size:>12} bytes of frame 0, {joins} bytes for joining players"
        )
    return lines
