"""Slots from update to Gaussian; a refused chunk changes nothing, and memory is bounded."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from codec.errors import CorruptError, InvalidError
from codec.lattice.lattice import POSITION_LIMIT, States
from codec.slice import HIDDEN
from codec.slots import decoder as slotdecoder
from codec.slots.change import Newcomers, encode_change
from codec.slots.decoder import SlotDecoder
from codec.slots.encoder import SlotEncoder
from codec.slots.skipmap import SkipMapHistory, decode_skip_map, encode_skip_map
from codec.slots.slotlayout import ENDED, KEPT, NEW, PREDICTED, SlotLayout, Update
from codec.slots.state import EMPTY, ESCAPED, ON_LATTICE, UNKNOWN, Slots, encode_keyframe
from codec.splats import Splats
from tests.support.drawn import same_splats
from tests.support.hostile import flips, refused, survives
from tests.support.slots.plain import Chunks, encoded_chunks, onto
from tests.support.slots.trained_updates import trained_like_layout, trained_like_updates
from tests.support.slots.updates import Model, patternless_updates, small_layout


def made(layout: SlotLayout, num_frames: int) -> Chunks:
    return encoded_chunks(layout, patternless_updates(layout, num_frames, 5))


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


def loaded(layout: SlotLayout, chunks: Chunks) -> SlotDecoder:
    decoder = SlotDecoder(layout)
    for data in chunks.keyframes[0]:
        decoder.load(data)
    return decoder


def test_what_is_out_of_turn_is_refused() -> None:
    layout = small_layout(2, (5, 3))
    chunks = made(layout, 6)
    decoder = SlotDecoder(layout)
    refused(InvalidError, "does not follow nothing", decoder.apply, 1, *chunks.slice(1))
    refused(InvalidError, "not one of the window", decoder.whole, 0)
    for data in chunks.keyframes[0]:
        decoder.load(data)
    refused(InvalidError, "does not follow the slice born at 0", decoder.apply, 2, *chunks.slice(2))
    decoder.apply(1, *chunks.slice(1))
    with pytest.raises(CorruptError, match="of frame 0 where that of 1 belongs"):
        decoder.load(chunks.keyframes[0][0], frame=1)
    before = state_bytes(decoder)
    assert not decoder.load(chunks.keyframes[0][0])
    assert state_bytes(decoder) == before
    refused(InvalidError, "3 changes for 2", decoder.apply, 2, chunks.skip_maps[2], [None] * 3)
    for birth in (-1, 2):
        refused(InvalidError, "not one of the window", decoder.whole, birth)
    refused(InvalidError, "come to 1, not 0", decoder.window, 0)
    refused(InvalidError, "3 layers of 2", decoder.window, 1, 3)
    refused(InvalidError, "3 layers of 2", SlotDecoder, layout, 3)
    with pytest.raises(InvalidError, match="of layer 1, held are 1"):
        SlotDecoder(layout, 1).load(chunks.keyframes[0][1])


def test_what_breaks_a_rule_leaves_all_as_it_was() -> None:
    layout = small_layout(2, (5, 3))
    chunks = made(layout, 6)
    decoder = loaded(layout, chunks)
    decoder.apply(1, *chunks.slice(1))
    skip_map, changes = chunks.slice(2)
    before = state_bytes(decoder)

    def with_skip_map(wrong: bytes) -> None:
        decoder.apply(2, wrong, changes)

    def with_change(wrong: bytes) -> None:
        decoder.apply(2, skip_map, [changes[0], wrong])

    refused = 0
    for decode, data in ((with_skip_map, skip_map), (with_change, changes[1])):
        for wrong in flips(data):
            if survives(decode, wrong):
                decoder = loaded(layout, chunks)
                decoder.apply(1, *chunks.slice(1))
            else:
                refused += 1
                assert state_bytes(decoder) == before
                assert decoder.frame == 1
    assert refused > 100
    decoder.apply(2, skip_map, changes)


def test_what_late_changes_need_has_a_bound(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(slotdecoder, "MIN_LOG_BYTES", 4000)
    layout = small_layout(3, (60, 40), segment_frames=200)
    chunks = made(layout, 120)
    decoder = loaded(layout, chunks)
    state = sum(map(len, state_bytes(decoder)))
    for birth in range(1, 120):
        skip_map, changes = chunks.slice(birth)
        decoder.apply(birth, skip_map, [changes[0] if birth % 7 else None, changes[1]])
        assert decoder.log_bytes <= max(4000, (slotdecoder.LOG_SHARE + 1) * state)
    assert decoder.log_bytes > 0
    assert not decoder.late(7, 0, chunks.changes[7][0])


def test_the_bound_leaves_room_for_a_segment(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(slotdecoder, "MIN_LOG_BYTES", 0)
    layout = trained_like_layout(2000, 1, 30)
    encoder, decoder = SlotEncoder(layout), SlotDecoder(layout)
    keyframes: list[bytes] = []
    for update in trained_like_updates(layout, 30, 0.3):
        encoded = encoder.append(update)
        if update.birth == 0:
            keyframes = [chunk.data for chunk in encoder.keyframes()]
            decoder.load(keyframes[0])
        elif encoded is not None:
            decoder.apply(
                update.birth, encoded.skip_map.data, [one.data for one in encoded.changes]
            )
    for data in keyframes[1:]:
        assert decoder.load(data)
    for slots, wanted in zip(decoder.lanes[0], encoder.lanes[0], strict=True):
        assert (slots.conditions == wanted.conditions).all()
        assert (slots.states.positions == wanted.states.positions).all()
    assert decoder.log_bytes == 0


def test_a_layer_that_is_not_expected_is_not_waited_for() -> None:
    layout = small_layout(2, (50, 50), segment_frames=50)
    chunks = made(layout, 30)
    decoder = SlotDecoder(layout)
    decoder.load(chunks.keyframes[0][0])
    for birth in range(1, 30):
        skip_map, changes = chunks.slice(birth)
        shown = decoder.apply(birth, skip_map, changes[:1])
        assert decoder.log_bytes == 0
        beyond = shown.rows is not None and shown.rows >= 50
        assert (shown.start_offsets[beyond] == HIDDEN).all()
    assert not decoder.late(29, 1, chunks.changes[29][1])


def test_a_late_change_that_does_not_fit_alters_nothing() -> None:
    layout = small_layout(1, (40,), segment_frames=50)
    chunks = made(layout, 6)
    decoder = loaded(layout, chunks)
    skip_map, changes = chunks.slice(1)
    decoder.apply(1, skip_map, [None])
    decoder.apply(2, *chunks.slice(2))
    before = state_bytes(decoder)
    refused(CorruptError, "birth 3 where birth 1 belongs", decoder.late, 1, 0, chunks.changes[3][0])
    assert state_bytes(decoder) == before
    assert decoder.late(1, 0, changes[0])
    other = loaded(layout, chunks)
    for birth in (1, 2):
        other.apply(birth, *chunks.slice(birth))
    assert state_bytes(other) == state_bytes(decoder)
    assert np.count_nonzero(decoder.lanes[0][0].conditions) == 40


def test_what_came_late_is_handed_out_with_the_next_slice() -> None:
    layout = small_layout(1, (40,), segment_frames=50)
    chunks = made(layout, 6)
    decoder = loaded(layout, chunks)
    (shown,) = decoder.hand_out(0)
    for birth in (1, 2, 3):
        shown = onto(decoder.apply(birth, chunks.skip_maps[birth], [None]), shown)
    for birth in (1, 3):
        assert decoder.late(birth, 0, chunks.changes[birth][0])
    shown = onto(decoder.apply(4, *chunks.slice(4)), shown)
    assert same_splats(shown.splats, decoder.whole(4).splats)
    assert (shown.start_offsets == decoder.whole(4).start_offsets).all()


def conditions(decoder: SlotDecoder, lane: int) -> list[int]:
    return [int(one) for slots in decoder.lanes[lane] for one in slots.conditions]


def test_a_missing_skip_map_costs_its_lane_until_the_segment_ends() -> None:
    layout = small_layout(2, (9, 6), segment_frames=8)
    chunks = made(layout, 12)
    decoder, player = loaded(layout, chunks), loaded(layout, chunks)
    for birth in range(1, 12):
        skip_map, changes = chunks.slice(birth)
        player.apply(birth, skip_map, changes)
        if birth == 3:
            shown = decoder.apply(birth, None, changes)
            assert shown.rows is not None
            assert shown.rows.tolist() == list(range(15))
            assert (shown.start_offsets == HIDDEN).all()
        elif birth in (5, 7):  # unreadable without the previous skip map
            decoder.apply(birth, b"any", [b"any"])
        else:
            decoder.apply(birth, skip_map, changes)
        # In the next segment its keyframe may still arrive.
        assert decoder.log_bytes == 0 or birth >= 9
        assert conditions(decoder, 0) == conditions(player, 0)
        if 3 <= birth < 9:
            assert set(conditions(decoder, 1)) == {UNKNOWN}
    # After births 9 and 11, only ended and new slots are known again.
    said = np.zeros(15, np.bool_)
    history = SkipMapHistory(layout)
    for birth in (9, 11):
        statuses = decode_skip_map(layout, birth, chunks.skip_maps[birth], history.of(birth))
        history.note(birth, statuses)
        said |= (statuses == ENDED) | (statuses == NEW)
    assert 0 < np.count_nonzero(said) < 15
    found, wanted = np.array(conditions(decoder, 1)), np.array(conditions(player, 1))
    assert (found == np.where(said, wanted, UNKNOWN)).all()


def test_what_waits_for_late_changes_is_given_up_with_the_skip_map() -> None:
    layout = small_layout(1, (40,), segment_frames=50)
    chunks = made(layout, 4)
    decoder = loaded(layout, chunks)
    decoder.apply(1, chunks.skip_maps[1], [None])
    assert decoder.log_bytes
    decoder.apply(2, None, [None])
    assert not decoder.log_bytes
    assert not decoder.late(1, 0, chunks.changes[1][0])
    assert not decoder.late(2, 0, chunks.changes[2][0])
    assert set(conditions(decoder, 0)) == {UNKNOWN}


def test_a_change_that_a_late_one_shows_to_be_wrong_counts_as_missing() -> None:
    """While a slot is unknown, its sums are not computed, so that a wrong one is not noticed."""
    layout = small_layout(1, (2,), segment_frames=50)
    edge = States(np.array([[POSITION_LIMIT - 1, 0, 0]], np.int32), np.zeros((1, 10), np.uint8))
    inside = States(edge.positions - np.int32(9), edge.attributes)
    nothing = States.zeros(0, 0)

    def skip_map(birth: int, first: int, second: int) -> bytes:
        statuses, history = np.array([first, second], np.uint8), SkipMapHistory(layout)
        if birth == 2:
            history.note(1, np.array([NEW, KEPT], np.uint8))
        return encode_skip_map(layout, birth, statuses, history.of(birth)).data

    def change(birth: int, before: States, predicted: States, new: States) -> bytes:
        newcomers = Newcomers(new, np.zeros(len(new), np.bool_), Splats.empty())
        offsets = np.zeros(len(new), np.uint8)
        return encode_change(0, birth, before, predicted, newcomers, offsets).data

    empty = [Slots(2, 0, EMPTY)]
    decoder = SlotDecoder(layout)
    decoder.load(encode_keyframe(layout, 0, 0, empty).data)
    decoder.apply(1, skip_map(1, NEW, KEPT), [None])
    # Beyond the edge if the first change is there; the second slot is new.
    decoder.apply(2, skip_map(2, PREDICTED, NEW), [change(2, inside, edge, inside)])
    assert conditions(decoder, 0) == [UNKNOWN, ON_LATTICE]
    assert decoder.late(1, 0, change(1, nothing, nothing, edge))
    assert conditions(decoder, 0) == [UNKNOWN, UNKNOWN]
    assert decoder.log_bytes == 0
    shown = decoder.apply(3, skip_map(3, KEPT, KEPT), [None])
    assert shown.rows is not None
    assert shown.rows.tolist() == [0, 1]


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
            for data in stream.chunks.keyframes[0]:
                decoder.load(data)
            decoder.hand_out(0)
        elif update.birth > 0:
            change = decoder.apply(update.birth, *stream.chunks.slice(update.birth))
            assert change.rows is not None
            assert change.rows.tolist() == np.flatnonzero(update.statuses).tolist()
            lane = layout.lane(update.birth)
            held = [value(s, row) for s in decoder.lanes[lane] for row in range(len(s.conditions))]
            assert held == [model.held[lane, row] for row in range(layout.num_slots)]
    assert decoder.frame == len(stream.chunks.skip_maps) - 1


@given(streams)
@settings(max_examples=20)
def test_a_keyframe_of_what_was_read_is_the_one_that_was_written(stream: Encoded) -> None:
    decoder = SlotDecoder(stream.layout)
    encoder = SlotEncoder(stream.layout)
    for first, keyframes in stream.chunks.keyframes.items():
        decoder.clear()
        for data in keyframes:
            decoder.load(data)
        encoder.lanes, encoder.next_birth = decoder.lanes, first + 1
        assert [chunk.data for chunk in encoder.keyframes()] == keyframes
