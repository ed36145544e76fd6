"""What a client holds, as mathematics."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from server.abr.holding import SliceHolding
from server.abr.media import SegmentSizes, rising
from server.abr.slotholding import SlotHolding
from tests.support.delivery.media import MadeMedia, demo_media, slot_media

PACKETS = [(birth, layer) for birth in range(-4, 12) for layer in range(4)]


@given(st.permutations(PACKETS), st.integers(0, len(PACKETS)))
def test_of_whole_slices_what_is_here_does_not_go_by_the_order(
    packets: list[tuple[int, int]], count: int
) -> None:
    holding, here = SliceHolding(demo_media(12), 0), set(packets[:count])
    for birth, layer in packets[:count]:
        holding.add(birth, layer, layer + 1)
    for birth in range(-4, 12):
        level = next(n for n in range(5) if (birth, n) not in here)
        assert holding.level(birth) == level
    gap = next(birth for birth in range(-4, 13) if (birth, 0) not in here)
    assert holding.end_frame == max(0, gap)
    born = {(birth, layer) for birth, layer in PACKETS if birth >= 0}
    assert holding.is_complete(0, 12) == (born <= here)
    if holding.end_frame:
        levels = [holding.level(birth) for birth in range(-4, 1)]
        assert holding.layers(0) == pytest.approx(sum(levels) / 5)


@given(st.permutations(PACKETS), st.integers(0, len(PACKETS)), st.integers(0, 11))
def test_more_packets_never_make_a_worse_picture(
    packets: list[tuple[int, int]], count: int, frame: int
) -> None:
    holding = SliceHolding(demo_media(12), 0)
    for birth in range(-4, 12):
        holding.add(birth, 0, 1)
    before_db = holding.psnr_db(frame)
    for birth, layer in packets[:count]:
        holding.add(birth, layer, layer + 1)
        after_db = holding.psnr_db(frame)
        assert after_db >= before_db - 1e-9
        before_db = after_db
    assert before_db <= 29.7 + 1e-9


def test_where_slots_last_a_layer_that_stops_wears_away() -> None:
    holding = SlotHolding(slot_media(90), 30)
    holding.add_snapshots(30, 0, 2)
    for birth in range(31, 60):
        holding.add(birth, 0, 2 if birth < 40 else 1)
    assert holding.end_frame == 60
    assert holding.fresh(1, 39) == 1
    assert holding.fresh(1, 41) == pytest.approx(0.85**2)
    assert holding.fresh(1, 29) == 0
    assert holding.layers(41) == pytest.approx(1 + 0.85**2)
    assert holding.psnr_db(41) == pytest.approx(27.82 + 0.96 * 0.85**2)
    # Late changes mend it from the first gap on.
    for birth in range(40, 45):
        holding.add(birth, 1, 2)
    assert holding.fresh(1, 44) == 1
    assert holding.end_birth(1) == 45
    # And a snapshot begins anew.
    holding.add_snapshots(60, 1, 2)
    assert holding.fresh(1, 60) == 1
    assert holding.fresh(1, 59) == pytest.approx(0.85**15)


def test_a_chain_that_grows_into_the_next_is_one() -> None:
    holding = SlotHolding(slot_media(90), 0)
    holding.add_snapshots(0, 0, 1)
    holding.add_snapshots(30, 0, 1)
    assert holding.end_frame == 1  # the snapshot of 30 fills no gap
    for birth in range(1, 31):
        holding.add(birth, 0, 1)
    assert holding.fresh(0, 30) == holding.fresh(0, 15) == 1
    holding.add(31, 0, 1)
    assert holding.end_birth(0) == 32
    holding.forget(20)
    assert holding.fresh(0, 31) == 1


def test_all_layers_that_are_needed_make_a_frame() -> None:
    holding = SlotHolding(slot_media(90), 0, needed=3)
    holding.add_snapshots(0, 0, 2)
    assert holding.end_frame == 0
    holding.add_snapshots(0, 2, 4)
    assert holding.end_frame == 1


def test_qualities_rise_even_where_they_are_unknown_or_odd() -> None:
    assert rising((30.0, 29.0, 31.0), (1.0, 1.0, 1.0)) == (30.0, 30.0, 31.0)
    guessed = rising((float("nan"), 30.0), (100.0, 300.0))
    assert list(guessed) == pytest.approx([24.0, 30.0])
    media = MadeMedia((SegmentSizes((1.0, 2.0), guessed),))
    assert media.sizes(0).gains_db == pytest.approx((24.0, 6.0))
    assert media.sizes(0).slice_bytes == (1.0, 3.0)
