"""The decoder's rules: what it refuses leaves it as it was, and its memory has a bound."""

from __future__ import annotations

import numpy as np
import pytest

from codec.errors import CorruptError, InvalidError
from codec.slice import HIDDEN
from codec.slots import slotdecoder
from codec.slots.slotdecoder import SlotDecoder
from codec.slots.slotencoder import EncodedSlice, SlotEncoder
from codec.slots.slotlayout import SlotLayout
from tests.support.hostile import flips, survives
from tests.support.slots.updates import patternless_updates, small_layout


def made(layout: SlotLayout, num_frames: int) -> tuple[list[bytes], dict[int, EncodedSlice]]:
    """The snapshots of frame 0, and the slices by birth."""
    encoder, snapshots, slices = SlotEncoder(layout), [], {}
    for update in patternless_updates(layout, num_frames, 5):
        encoded = encoder.append(update)
        if update.birth == 0:
            snapshots = [chunk.data for chunk in encoder.snapshots()]
        if encoded is not None:
            slices[update.birth] = encoded
    return snapshots, slices


def state_bytes(decoder: SlotDecoder) -> list[bytes]:
    return [
        part.tobytes()
        for lane in decoder.lanes
        for slots in lane
        for part in (
            slots.conditions,
            slots.states.positions,
            slots.states.attributes,
            slots.starts,
            slots.escape_rows,
            *slots.escapes.arrays,
        )
    ]


def parts(slice: EncodedSlice) -> tuple[bytes, list[bytes]]:
    return slice.mask.data, [change.data for change in slice.changes]


def test_what_is_out_of_turn_is_refused() -> None:
    layout = small_layout(2, (5, 3))
    snapshots, slices = made(layout, 6)
    decoder = SlotDecoder(layout)
    with pytest.raises(InvalidError, match="does not follow nothing"):
        decoder.apply(1, *parts(slices[1]))
    with pytest.raises(InvalidError, match="not one of the window"):
        decoder.whole(0)
    for data in snapshots:
        decoder.load(data)
    with pytest.raises(InvalidError, match="does not follow the slice born at 0"):
        decoder.apply(2, *parts(slices[2]))
    decoder.apply(1, *parts(slices[1]))
    with pytest.raises(CorruptError, match="of frame 0 where that of 1 belongs"):
        decoder.load(snapshots[0])
    with pytest.raises(InvalidError, match="3 changes for 2"):
        decoder.apply(2, slices[2].mask.data, [None] * 3)
    for birth in (-1, 2):
        with pytest.raises(InvalidError, match="not one of the window"):
            decoder.whole(birth)
    with pytest.raises(InvalidError, match="come to 1, not 0"):
        decoder.window(0)
    with pytest.raises(InvalidError, match="3 layers of 2"):
        decoder.window(1, 3)
    with pytest.raises(InvalidError, match="3 layers of 2"):
        SlotDecoder(layout, 3)
    with pytest.raises(InvalidError, match="of layer 1, held are 1"):
        SlotDecoder(layout, 1).load(snapshots[1])


def test_what_breaks_a_rule_leaves_all_as_it_was() -> None:
    layout = small_layout(2, (5, 3))
    snapshots, slices = made(layout, 6)
    decoder = SlotDecoder(layout)
    for data in snapshots:
        decoder.load(data)
    decoder.apply(1, *parts(slices[1]))
    mask, changes = parts(slices[2])
    before = state_bytes(decoder)

    def with_mask(wrong: bytes) -> None:
        decoder.apply(2, wrong, changes)

    def with_change(wrong: bytes) -> None:
        decoder.apply(2, mask, [changes[0], wrong])

    refused = 0
    for decode, data in ((with_mask, mask), (with_change, changes[1])):
        for wrong in flips(data):
            if survives(decode, wrong):
                decoder = SlotDecoder(layout)
                for snapshot in snapshots:
                    decoder.load(snapshot)
                decoder.apply(1, *parts(slices[1]))
            else:
                refused += 1
                assert state_bytes(decoder) == before
                assert decoder.frame == 1
    assert refused > 100
    decoder.apply(2, mask, changes)


def test_what_late_changes_need_has_a_bound(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(slotdecoder, "MIN_LOG_BYTES", 4000)
    layout = small_layout(3, (60, 40), segment_frames=200)
    snapshots, slices = made(layout, 120)
    decoder = SlotDecoder(layout)
    for data in snapshots:
        decoder.load(data)
    state = sum(map(len, state_bytes(decoder)))
    for birth in range(1, 120):
        mask, changes = parts(slices[birth])
        decoder.apply(birth, mask, [changes[0] if birth % 7 else None, changes[1]])
        assert decoder.log_bytes <= max(4000, 2 * state)
    assert decoder.log_bytes > 0
    assert decoder.late(7, 0, slices[7].changes[0].data) is None


def test_a_layer_that_is_not_expected_is_not_waited_for() -> None:
    layout = small_layout(2, (50, 50), segment_frames=50)
    snapshots, slices = made(layout, 30)
    decoder = SlotDecoder(layout)
    decoder.load(snapshots[0])
    for birth in range(1, 30):
        mask, changes = parts(slices[birth])
        shown = decoder.apply(birth, mask, changes[:1])
        assert decoder.log_bytes == 0
        beyond = shown.rows is not None and shown.rows >= 50
        assert (shown.start_offsets[beyond] == HIDDEN).all()
    assert decoder.late(29, 1, slices[29].changes[1].data) is None


def test_a_late_change_that_does_not_fit_alters_nothing() -> None:
    layout = small_layout(1, (40,), segment_frames=50)
    snapshots, slices = made(layout, 6)
    decoder = SlotDecoder(layout)
    decoder.load(snapshots[0])
    mask, changes = parts(slices[1])
    decoder.apply(1, mask, [None])
    decoder.apply(2, *parts(slices[2]))
    before = state_bytes(decoder)
    with pytest.raises(CorruptError, match="birth 3 where birth 1 belongs"):
        decoder.late(1, 0, slices[3].changes[0].data)
    assert state_bytes(decoder) == before
    assert decoder.late(1, 0, changes[0]) is not None
    other = SlotDecoder(layout)
    other.load(snapshots[0])
    for birth in (1, 2):
        other.apply(birth, *parts(slices[birth]))
    assert state_bytes(other) == state_bytes(decoder)
    assert np.count_nonzero(decoder.lanes[0][0].conditions) == 40
