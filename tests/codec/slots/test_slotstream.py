"""Slots from update to Gaussian: every reader has the integers that section 7 defines."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from codec.slots.slotdecoder import SlotDecoder
from codec.slots.slotencoder import SlotEncoder
from codec.slots.slotlayout import SlotLayout
from codec.slots.slotstate import EMPTY, ESCAPED, UNKNOWN, Slots
from codec.slots.update import Update
from tests.support.slots.plain import Chunks, encoded_chunks
from tests.support.slots.updates import Model, patternless_updates, small_layout


@dataclass(frozen=True)
class Encoded:
    """A stream of slots in memory."""

    layout: SlotLayout
    updates: list[Update]
    chunks: Chunks


def encoded(layout: SlotLayout, num_frames: int, seed: int, wild: bool = False) -> Encoded:
    updates = patternless_updates(layout, num_frames, seed, wild)
    return Encoded(layout, updates, encoded_chunks(layout, updates))


layouts = st.builds(
    small_layout,
    swin_size=st.sampled_from([1, 2, 5]),
    slots=st.sampled_from([(1,), (7,), (5, 3), (2, 9, 4)]),
    sh_degree=st.sampled_from([0, 1]),
    segment_frames=st.sampled_from([1, 3, 4, 7]),
)
streams = st.builds(
    encoded,
    layout=layouts,
    num_frames=st.just(16),
    seed=st.integers(0, 1 << 32),
    wild=st.booleans(),
)


def value(slots: Slots, row: int) -> tuple[str, bytes] | None:
    """State of a slot in the form of `Model`."""
    condition = slots.conditions[row]
    assert condition != UNKNOWN
    if condition == EMPTY:
        return None
    if condition == ESCAPED:
        at = slots.escape_rows.tolist().index(row)
        one = slots.escapes.take(np.array([at]))
        return "escape", b"".join(array.tobytes() for array in one.arrays)
    state = slots.states.take(np.array([row]))
    return "lattice", state.positions.tobytes() + state.attributes.tobytes()


@given(streams)
@settings(max_examples=25)
def test_a_reader_that_has_all_has_what_was_given(stream: Encoded) -> None:
    """What it holds when something is missing is compared with another reader in
    test_agreement.py."""
    layout = stream.layout
    model, decoder = Model(layout), SlotDecoder(layout)
    for update in stream.updates:
        model.take(update)
        if update.birth == 0:
            for data in stream.chunks.snapshots[0]:
                decoder.load(data)
            decoder.hand_out(0)
        elif update.birth > 0:
            change = decoder.apply(update.birth, *stream.chunks.slice(update.birth))
            assert change.rows is not None
            assert change.rows.tolist() == np.flatnonzero(update.statuses).tolist()
            lane = layout.lane(update.birth)
            held = [value(s, row) for s in decoder.lanes[lane] for row in range(len(s.conditions))]
            assert held == [model.held[lane, row] for row in range(layout.num_slots)]
    assert decoder.frame == len(stream.chunks.masks) - 1


@given(streams)
@settings(max_examples=20)
def test_a_snapshot_of_what_was_read_is_the_one_that_was_written(stream: Encoded) -> None:
    decoder = SlotDecoder(stream.layout)
    encoder = SlotEncoder(stream.layout)
    for first, snapshots in stream.chunks.snapshots.items():
        decoder.clear()
        for data in snapshots:
            decoder.load(data)
        encoder.lanes, encoder.next_birth = decoder.lanes, first + 1
        assert [chunk.data for chunk in encoder.snapshots()] == snapshots
