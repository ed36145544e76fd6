"""Skip maps, changes and keyframes: the farthest ways fit, and breaches of a rule are refused."""

from __future__ import annotations

import struct
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from codec.errors import CodecError, CorruptError, InvalidError, UnsupportedError
from codec.lattice.lattice import POSITION_LIMIT, Lattice, States
from codec.slots.change import Change, Newcomers, decode_change, encode_change
from codec.slots.decoder import SlotDecoder
from codec.slots.encoder import SlotEncoder
from codec.slots.skipmap import SkipMapHistory, decode_skip_map, encode_skip_map
from codec.slots.slotlayout import (
    MAX_SLOT_CHUNK_BYTES,
    NEW,
    PREDICTED,
    SLOT_HEADER,
    SlotLayout,
    Update,
)
from codec.splats import Splats
from tests.support.hostile import flips, refused, survives, truncations
from tests.support.slots.updates import (
    LATTICE,
    patternless_splats,
    patternless_states,
    patternless_updates,
    small_layout,
)

BODY = SLOT_HEADER.size


def test_the_farthest_ways_fit() -> None:
    """Predicted and new Gaussians move from one corner of the lattice to the other and back."""
    edge = POSITION_LIMIT - 1
    layout = small_layout(2, (8,))
    corners = States(
        np.array([[edge] * 3, [-edge] * 3] * 2, np.int32), np.full((4, 10), 100, np.uint8)
    )
    others = States(-corners.positions, np.full((4, 10), 30, np.uint8))
    none = Newcomers(corners, np.zeros(4, np.bool_), Splats.empty())
    data = encode_change(0, 1, corners, others, none, np.zeros(4, np.uint8)).data
    change = decode_change(layout, 0, 1, data, 4, 4)
    found = change.predict(corners, np.ones(4, np.bool_))
    assert (found.positions == others.positions).all()
    assert (found.attributes == others.attributes).all()
    assert (change.new.states.positions == corners.positions).all()


def good_change() -> tuple[SlotLayout, bytes, Callable[[bytes], States]]:
    """A layout, a change of 6 predicted and 5 new Gaussians, and a function that reads it."""
    rng = np.random.default_rng(4)
    layout = small_layout(3, (20,))
    levels = [layout.lattices[0].opacity_levels]
    before, predicted = (patternless_states(rng, levels * 6, 0, True) for _ in range(2))
    escaped = np.array([0, 1, 0, 0, 1], np.bool_)
    new = Newcomers(patternless_states(rng, levels * 5, 0), escaped, patternless_splats(rng, 2, 0))
    offsets = (np.arange(5) % 3).astype(np.uint8)
    data = encode_change(0, 7, before, predicted, new, offsets).data

    def decode(data: bytes) -> States:
        change = decode_change(layout, 0, 7, data, 6, 5)
        assert len(change.start_offsets) == 5
        return change.predict(before, np.ones(6, np.bool_))

    assert (decode(data).positions == predicted.positions).all()
    return layout, data, decode


def test_what_is_refused() -> None:
    layout, data, decode = good_change()
    counts = struct.unpack_from("<5I", data, BODY)
    assert counts[:2] == (6, 5)
    assert counts[2] > 0
    assert counts[3] == 2
    for n, message in enumerate(("predicted", "new", "long residuals", "escapes")):
        for value in (0, counts[n] + 1, 1 << 31):
            wrong = list(counts)
            wrong[n] = value
            with pytest.raises(CorruptError) as caught:
                decode(data[:BODY] + struct.pack("<5I", *wrong) + data[BODY + 20 :])
            if value > 20 or n < 2:
                assert message in str(caught.value)
                assert caught.value.at == BODY + 4 * n
    planes = BODY + 20
    new_planes = planes + 13 * 6 + 4 * counts[2]
    escapes = new_planes + 13 * 5 + counts[4]
    for at, value, message in (
        (new_planes, 26, "26 bits"),
        (new_planes + 12 * 5, 161, "opacity 161"),
        (new_planes + 2, 0, "low bits"),
        (escapes, 4, "do not rise"),
        (escapes + 4, 5, "do not rise"),
        (len(data) - 1, 3, "start offset 3 of 3"),
    ):
        wrong_data = data[:at] + bytes([value]) + data[at + 1 :]
        refused(CorruptError, message, decode, wrong_data)
    endless = data[: escapes + 8] + struct.pack("<f", np.inf) + data[escapes + 12 :]
    refused(CorruptError, "not finite", decode, endless)
    zero = data[: escapes + 8 + 12 * 4] + bytes(32) + data[escapes + 8 + 12 * 4 + 32 :]
    refused(CorruptError, "zero quaternion", decode, zero)
    for place, value in ((6, 2), (7, 1)):
        refused(UnsupportedError, "", decode, data[:place] + bytes([value]) + data[place + 1 :])
    for place, message in ((5, "layer 1"), (8, "birth")):
        refused(CorruptError, message, decode, data[:place] + b"\1" + data[place + 1 :])
    refused(CorruptError, "the skip map declares 7", decode_change, layout, 0, 7, data, 7, 5)


def test_a_sum_outside_the_lattice_is_refused() -> None:
    layout = small_layout(2, (4,))
    state = States(np.array([[POSITION_LIMIT - 1, 0, 0]], np.int32), np.zeros((1, 10), np.uint8))
    none = Newcomers(States.zeros(0, 0), np.zeros(0, np.bool_), Splats.empty())
    moved = replace(state, positions=state.positions - 1)
    # From a state nearer the edge, the same residual leads outside.
    data = encode_change(0, 1, moved, state, none, np.zeros(0, np.uint8)).data
    change: Change = decode_change(layout, 0, 1, data, 1, 0)
    assert (change.predict(moved, np.ones(1, np.bool_)).positions == state.positions).all()
    refused(CorruptError, "leaves the lattice", change.predict, state, np.ones(1, np.bool_))
    assert not change.predict(state, np.zeros(1, np.bool_)).positions.any()
    bright = replace(state, attributes=np.full((1, 10), 160, np.uint8))
    dim = replace(state, attributes=np.full((1, 10), 150, np.uint8))
    data = encode_change(0, 1, dim, bright, none, np.zeros(0, np.uint8)).data
    change = decode_change(layout, 0, 1, data, 1, 0)
    refused(CorruptError, "leaves the lattice", change.predict, bright, np.ones(1, np.bool_))


def test_any_bytes_give_a_keyframe_or_an_error() -> None:
    layout = small_layout(3, (6, 5))
    encoder = SlotEncoder(layout)
    for update in patternless_updates(layout, 5, 3):
        encoder.append(update)
    data = encoder.keyframes()[1].data

    def load(wrong: bytes) -> None:
        decoder = SlotDecoder(layout)
        try:
            decoder.load(wrong)
        except CodecError:
            assert decoder.frame is None
            raise
        decoder.window(decoder.frame or 0)

    assert survives(load, data)
    assert len(data) <= layout.max_keyframe_bytes(1)
    assert not any(survives(load, wrong) for wrong in truncations(data))
    assert any(survives(load, wrong) for wrong in flips(data))
    for wrong, message in (
        (data[:5] + b"\2" + data[6:], "layer 2 of 2"),
        (data[:8] + b"\3" + data[9:], "frame 3 is not the first"),
        (data[:8] + b"\xfc\xff\xff\xff" + data[12:], "frame -4"),
        (data[:13] + bytes([data[13] | 0x80]) + data[14:], "after the last flag"),
        (data[:12] + bytes([data[12] ^ 1]) + data[13:], "new, the skip map declares"),
    ):
        refused(CorruptError, message, load, wrong)


def test_what_an_encoder_refuses_leaves_it_as_it_was() -> None:
    layout = small_layout(1, (3,), segment_frames=2)
    encoder = SlotEncoder(layout)
    refused(InvalidError, "not the first of a segment", encoder.keyframes)
    good = Update(
        0,
        np.array([NEW, NEW, 0], np.uint8),
        States.zeros(2, 0),
        np.zeros(2, np.uint8),
        np.array([False, True]),
        patternless_splats(np.random.default_rng(0), 1, 0),
    )
    big = States(np.full((2, 3), -(1 << 31), np.int32), good.states.attributes)
    bright = States(good.states.positions, np.full((2, 10), 255, np.uint8))
    for wrong, message in (
        (replace(good, birth=1), "expected 0"),
        (replace(good, statuses=np.array([3, 3], np.uint8)), "not uint8"),
        (replace(good, statuses=np.array([3, 3, 4], np.uint8)), "at most 3"),
        (replace(good, statuses=np.array([3, 0, 0], np.uint8)), "positions are"),
        (replace(good, start_offsets=np.array([0, 1], np.uint8)), "start offset 1 of 1"),
        (replace(good, escaped=np.array([True, True])), "1 escapes, 2"),
        (replace(good, escapes=patternless_splats(np.random.default_rng(0), 1, 1)), "SH degree"),
        (replace(good, states=big), "position"),
        (replace(good, states=bright), "opacity"),
        (replace(good, statuses=np.array([2, 3, 0], np.uint8)), "slot 0 of layer 0.*is empty"),
        (replace(good, statuses=np.array([3, 2, 0], np.uint8)), "a predicted Gaussian escapes"),
    ):
        refused(InvalidError, message, encoder.append, wrong)
    assert encoder.append(good) is not None
    predicted = replace(
        good, birth=1, statuses=np.array([2, 2, 0], np.uint8), escaped=np.zeros(2, np.bool_)
    )
    predicted = replace(predicted, escapes=Splats.empty())
    with pytest.raises(InvalidError, match="slot 1 of layer 0 is predicted, but it has escaped"):
        encoder.append(predicted)
    assert encoder.append(Update.keeping(1, layout)) is not None


def test_only_a_new_gaussian_starts_late() -> None:
    layout = small_layout(3, (2,))
    encoder = SlotEncoder(layout)
    none = np.zeros(2, np.bool_)
    offsets = np.array([0, 2], np.uint8)
    both = States.zeros(2, 0)
    for birth in (-2, -1, 0):
        statuses = np.full(2, NEW, np.uint8)
        encoder.append(Update(birth, statuses, both, offsets, none, Splats.empty()))
    statuses = np.array([PREDICTED, NEW], np.uint8)
    late = Update(1, statuses, both, offsets[::-1].copy(), none, Splats.empty())
    refused(InvalidError, "a predicted Gaussian starts late", encoder.append, late)
    made = encoder.append(replace(late, start_offsets=offsets))
    assert made is not None
    # 13 bytes for each, and one more for the start of the new one.
    assert len(made.changes[0].data) == BODY + 20 + 2 * 13 + 1
    change = decode_change(layout, 0, 1, made.changes[0].data, 1, 1)
    assert change.start_offsets.tolist() == [2]


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"swin_size": 0}, "swin_size 0"),
        ({"swin_size": 256}, "swin_size 256"),
        ({"slots": ()}, "0 layers"),
        ({"slots": (1,) * 17}, "17 layers"),
        ({"slots": (0,)}, "at least 1"),
        ({"slots": (1 << 20, 1)}, "together at most"),
        ({"sh_degree": 4}, "SH degree 4"),
        ({"lattices": (LATTICE,) * 2}, "2 lattices for 1"),
        ({"segment_frames": 0}, "segment_frames 0"),
        ({"segment_frames": 4097}, "segment_frames 4097"),
        ({"segment_frames": 257, "slots": (1 << 20,)}, "use shorter segments"),
        ({"swin_size": 17, "slots": (1 << 20,)}, "in each of 17 lanes"),
    ],
)
def test_layouts_that_the_format_does_not_allow(change: dict[str, object], message: str) -> None:
    refused(InvalidError, message, replace, SlotLayout(2, (4,), 0, (LATTICE,), 8), **change)
    layout = SlotLayout(16, (1 << 19, 1 << 19), 3, (LATTICE,) * 2, 256)
    assert layout.max_change_bytes(0) < layout.max_keyframe_bytes(1) == MAX_SLOT_CHUNK_BYTES
    assert layout.max_skip_map_bytes == 16 + (4 << 20)
    assert SlotLayout(1, (1,), 0, (Lattice(1, 1, 1, 1, 2),), 1).max_change_bytes(0) == 12 + 20 + 83


@pytest.mark.parametrize("status", range(4))
def test_the_longest_and_the_dullest_skip_maps_fit(status: int) -> None:
    layout = small_layout(slots=(3000,))
    history = np.zeros(3000, np.uint8)
    dull = np.full(3000, status, np.uint8)
    assert len(encode_skip_map(layout, 0, dull, history).data) < 60
    # Equal statuses for long enough to be predicted, then different ones repeatedly.
    worst = np.resize(np.repeat(np.array([status, 3 - status], np.uint8), (120, 3)), 3000)
    chunk = encode_skip_map(layout, 0, worst, history)
    assert len(chunk.data) <= layout.max_skip_map_bytes
    assert (decode_skip_map(layout, 0, chunk.data, history) == worst).all()


def test_what_a_skip_map_refuses() -> None:
    layout = small_layout(slots=(40, 20))
    history = np.zeros(60, np.uint8)
    statuses = (np.arange(60) % 4).astype(np.uint8)
    data = encode_skip_map(layout, 9, statuses, history).data
    for wrong, message in (
        (data + b"\0", "are read"),
        (data[:-1], "are read"),
        (b"SWGC" + data[4:], "starts with"),
        (data[:4] + b"\1" + data[5:], "a change where a skip map belongs"),
        (data[:5] + b"\1" + data[6:], "layer 1 where 0 belongs"),
        (data[:12] + b"\xff" * 4 + data[16:], "not below its range"),
        (data[:11], "too few"),
    ):
        refused(CorruptError, message, decode_skip_map, layout, 9, wrong, history)
    refused(
        CorruptError, "birth 9 where birth 10 belongs", decode_skip_map, layout, 10, data, history
    )
    for place, value in ((4, 4), (6, 1), (6, 128), (7, 1)):
        wrong = data[:place] + bytes([value]) + data[place + 1 :]
        refused(UnsupportedError, "", decode_skip_map, layout, 9, wrong, history)


def test_history_is_of_the_lane_and_begins_anew_with_a_segment() -> None:
    layout = small_layout(swin_size=2, slots=(4,), segment_frames=6)
    history = SkipMapHistory(layout)
    history.note(6, np.array([1, 1, 1, 1], np.uint8))  # the segment's first frame
    assert history.of(8).tolist() == [0, 0, 0, 0]
    history.note(7, np.array([3, 3, 3, 3], np.uint8))  # the other lane
    history.note(8, np.array([0, 1, 0, 3], np.uint8))
    assert history.of(10).tolist() == [0, 2, 0, 2]
    history.note(9, np.array([0, 0, 0, 0], np.uint8))
    history.note(10, np.array([0, 0, 2, 2], np.uint8))
    assert history.of(12).tolist() == [0, 0, 0, 0]
    assert history.of(11).tolist() == [1, 1, 1, 1]
    history.note(11, np.zeros(4, np.uint8))
    history.note(12, np.zeros(4, np.uint8))
    assert history.of(14).tolist() == [0, 0, 0, 0]
    history.note(13, np.ones(4, np.uint8))
    assert history.of(14).tolist() == [0, 0, 0, 0]
    assert history.of(15).tolist() == [2, 2, 2, 2]
