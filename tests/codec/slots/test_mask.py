"""Masks: any statuses round-trip, and a decoder written from FORMAT.md alone reads the same."""

from __future__ import annotations

from itertools import chain

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from codec.errors import CorruptError, UnsupportedError
from codec.lattice.lattice import Bytes
from codec.slots.mask import MaskHistory, decode_mask, encode_mask
from codec.slots.slotlayout import HEADER_BYTES, SlotLayout
from tests.goldens import decoder as plain
from tests.support.hostile import flips, survives, truncations
from tests.support.slots.updates import small_layout


@st.composite
def masks(draw: st.DrawFn) -> tuple[SlotLayout, Bytes, Bytes]:
    """A layout, statuses, and the history of each slot."""
    slots = tuple(draw(st.lists(st.integers(1, 60), min_size=1, max_size=4)))
    rng = np.random.default_rng(draw(st.integers(0, 1 << 32)))
    weights = rng.dirichlet(np.full(4, 0.5))
    statuses = rng.choice(4, sum(slots), p=weights).astype(np.uint8)
    return small_layout(slots=slots), statuses, rng.integers(0, 4, sum(slots)).astype(np.uint8)


@given(masks())
@settings(max_examples=100)
def test_any_statuses_come_back(case: tuple[SlotLayout, Bytes, Bytes]) -> None:
    layout, statuses, history = case
    chunk = encode_mask(layout, 5, statuses, history)
    assert len(chunk.data) <= layout.max_mask_bytes
    assert (decode_mask(layout, 5, chunk.data, history) == statuses).all()
    if not statuses.any():
        assert chunk.data == b""
        return
    layers, bits = np.cumsum(layout.slots)[:-1], (history >> 1, history & 1)
    before = [[row.tolist() for row in np.split(one, layers)] for one in bits]
    by_text = plain.decode_mask(chunk.data[HEADER_BYTES:], layout.slots, before)
    assert list(chain(*by_text)) == statuses.tolist()


@pytest.mark.parametrize("status", range(4))
def test_the_longest_and_the_dullest_masks_fit(status: int) -> None:
    layout = small_layout(slots=(3000,))
    history = np.zeros(3000, np.uint8)
    dull = np.full(3000, status, np.uint8)
    assert len(encode_mask(layout, 0, dull, history).data) < 60
    # Equal statuses for long enough to be predicted, then different ones repeatedly.
    worst = np.resize(np.repeat(np.array([status, 3 - status], np.uint8), (120, 3)), 3000)
    chunk = encode_mask(layout, 0, worst, history)
    assert len(chunk.data) <= layout.max_mask_bytes
    assert (decode_mask(layout, 0, chunk.data, history) == worst).all()


def test_what_lasts_costs_little() -> None:
    """A spell of changes in the same slots is cheaper with its history than without."""
    rng = np.random.default_rng(1)
    layout = small_layout(swin_size=1, slots=(2000,), segment_frames=100)
    busy, history = rng.random(2000) < 0.1, MaskHistory(layout)
    with_history = without = 0
    for birth in range(1, 20):
        statuses = np.where(busy & (rng.random(2000) < 0.9), 2, 0).astype(np.uint8)
        with_history += len(encode_mask(layout, birth, statuses, history.of(birth)).data)
        without += len(encode_mask(layout, birth, statuses, np.zeros(2000, np.uint8)).data)
        history.note(birth, statuses)
    assert with_history < 0.7 * without


def test_history_is_of_the_lane_and_begins_anew_with_a_segment() -> None:
    layout = small_layout(swin_size=2, slots=(4,), segment_frames=6)
    history = MaskHistory(layout)
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


def test_what_is_refused() -> None:
    layout = small_layout(slots=(40, 20))
    history = np.zeros(60, np.uint8)
    statuses = (np.arange(60) % 4).astype(np.uint8)
    data = encode_mask(layout, 9, statuses, history).data
    for wrong, message in (
        (data + b"\0", "are read"),
        (data[:-1], "are read"),
        (b"SWGC" + data[4:], "starts with"),
        (data[:4] + b"\1" + data[5:], "a change where a mask belongs"),
        (data[:5] + b"\1" + data[6:], "layer 1 where 0 belongs"),
        (data[:12] + b"\xff" * 4 + data[16:], "not below its range"),
        (data[:11], "too few"),
    ):
        with pytest.raises(CorruptError, match=message):
            decode_mask(layout, 9, wrong, history)
    with pytest.raises(CorruptError, match="birth 9 where birth 10 belongs"):
        decode_mask(layout, 10, data, history)
    for place, value in ((4, 4), (6, 1), (6, 128), (7, 1)):
        wrong = data[:place] + bytes([value]) + data[place + 1 :]
        with pytest.raises(UnsupportedError):
            decode_mask(layout, 9, wrong, history)


def test_any_bytes_give_statuses_or_an_error() -> None:
    layout = small_layout(slots=(40, 20))
    history = np.zeros(60, np.uint8)
    statuses = (np.arange(60) * 7 % 11 % 4).astype(np.uint8)
    data = encode_mask(layout, 9, statuses, history).data

    def decode(wrong: bytes) -> None:
        found = decode_mask(layout, 9, wrong, history)
        assert found.max() <= 3
        assert encode_mask(layout, 9, found, history).data[:9] == wrong[:9]

    assert not any(survives(decode, wrong) for wrong in truncations(data) if wrong)
    assert any(survives(decode, wrong) for wrong in flips(data))
