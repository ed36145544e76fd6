"""The updates that a stream was written from, read back from its files."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from codec.arrays import Bytes
from codec.lattice.lattice import States
from codec.slice import window_births
from codec.slots.decoder import SlotDecoder
from codec.slots.slotlayout import KEPT, NEW, PREDICTED, Update
from codec.slots.state import ESCAPED, holds
from codec.splats import Splats
from codec.stream.manifest import SKIP_MAPS
from codec.stream.reader import StreamReader


def recorded_slices(reader: StreamReader) -> Iterator[tuple[int, SlotDecoder, Bytes]]:
    """For each slice of a stream its birth, a decoder that has just taken it in, and
    (S,) what it says of the slots of its lane. What frame 0 begins with counts as new."""
    manifest = reader.manifest
    decoder = reader.decoder_at(0, manifest.num_layers)
    for birth in window_births(0, manifest.swin_size):
        lane = decoder.lanes[decoder.layout.lane(birth)]
        held = np.concatenate([holds(slots.conditions) for slots in lane])
        yield birth, decoder, np.where(held, NEW, KEPT).astype(np.uint8)
    for birth in range(1, reader.num_frames):
        skip_map, *changes = (
            reader.read_object(manifest.segment_of(birth), part).content(birth)
            for part in (SKIP_MAPS, *range(manifest.num_layers))
        )
        statuses = decoder.statuses(birth, skip_map, changes)
        decoder.apply(birth, skip_map, changes)
        yield birth, decoder, statuses


def recorded_update(decoder: SlotDecoder, birth: int, statuses: Bytes) -> Update:
    """An update that says `statuses` of the slots in the lane of `birth`, with what `decoder`,
    which has all layers, holds there now. With the statuses of `recorded_slices` it is the update
    that was written."""
    layout = decoder.layout
    states, starts, escaped, escapes = [], [], [], []
    for layer, slots in enumerate(decoder.lanes[layout.lane(birth)]):
        part = statuses[layout.row_edges[layer] : layout.row_edges[layer + 1]]
        sent = np.flatnonzero(part >= PREDICTED)
        states.append(slots.states.take(sent))
        starts.append(slots.starts[sent])
        escaped.append(slots.conditions[sent] == ESCAPED)
        order = np.argsort(slots.escape_rows, kind="stable")
        order = order[np.isin(slots.escape_rows[order], sent)]
        escapes.append(slots.escapes.take(order))
    return Update(
        birth,
        statuses,
        States.concatenate(states),
        np.concatenate(starts),
        np.concatenate(escaped),
        Splats.concatenate(escapes),
    )
