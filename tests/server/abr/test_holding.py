"""Mathematics of a client's buffer."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from server.abr.decisioncontext import DecisionContext, Send, SendKeyframes, SendSlices
from server.abr.holding import Holding
from server.abr.link import Link, LinkStep
from server.abr.media import SegmentSizes, rising
from server.study.simulator import simulate
from tests.support.delivery.media import MadeMedia, basketball_media

BIRTHS = range(1, 12)
PACKETS = [(birth, layer) for birth in BIRTHS for layer in range(4)]


def behind_keyframes() -> Holding:
    holding = Holding(basketball_media(12), 0)
    holding.add_keyframes(0, 0, 4)
    return holding


@given(st.permutations(PACKETS))
def test_what_came_in_order_is_here_and_whole(packets: list[tuple[int, int]]) -> None:
    holding, ends = behind_keyframes(), [1] * 4
    for birth, layer in packets:
        holding.add(birth, layer, layer + 1)
        ends[layer] += birth == ends[layer]
        assert [holding.end_birth(layer) for layer in range(4)] == ends
        assert holding.end_frame == ends[0]
        assert holding.is_complete(0, 12) == (min(ends) == 12)


@given(st.permutations(PACKETS), st.integers(0, len(PACKETS)), st.integers(0, 11))
def test_more_packets_never_make_a_worse_picture(
    packets: list[tuple[int, int]], count: int, frame: int
) -> None:
    holding = behind_keyframes()
    for birth in BIRTHS:
        holding.add(birth, 0, 1)
    before_db = holding.psnr_db(frame)
    for birth, layer in packets[:count]:
        holding.add(birth, layer, layer + 1)
        after_db = holding.psnr_db(frame)
        assert after_db >= before_db - 1e-9
        before_db = after_db
    assert before_db <= 29.69 + 1e-9


def test_a_layer_that_stops_wears_away() -> None:
    holding = Holding(basketball_media(90), 30)
    holding.add_keyframes(30, 0, 2)
    for birth in range(31, 60):
        holding.add(birth, 0, 2 if birth < 40 else 1)
    assert holding.end_frame == 60
    assert holding.fresh(1, 39) == 1
    assert holding.fresh(1, 41) == pytest.approx(0.85**2)
    assert holding.fresh(1, 29) == 0
    assert holding.layers(41) == pytest.approx(1 + 0.85**2)
    assert holding.psnr_db(41) == pytest.approx(27.82 + 0.96 * 0.85**2)
    # Late changes repair it from the first gap on.
    for birth in range(40, 45):
        holding.add(birth, 1, 2)
    assert holding.fresh(1, 44) == 1
    assert holding.end_birth(1) == 45
    # And a keyframe starts over.
    holding.add_keyframes(60, 1, 2)
    assert holding.fresh(1, 60) == 1
    assert holding.fresh(1, 59) == pytest.approx(0.85**15)


def test_a_chain_that_grows_into_the_next_is_one() -> None:
    holding = Holding(basketball_media(90), 0)
    holding.add_keyframes(0, 0, 1)
    holding.add_keyframes(30, 0, 1)
    assert holding.end_frame == 1  # the keyframe of 30 fills no gap
    for birth in range(1, 31):
        holding.add(birth, 0, 1)
    assert holding.fresh(0, 30) == holding.fresh(0, 15) == 1
    holding.add(31, 0, 1)
    assert holding.end_birth(0) == 32
    holding.forget(20)
    assert holding.fresh(0, 31) == 1


def test_all_layers_that_are_needed_make_a_frame() -> None:
    holding = Holding(basketball_media(90), 0, needed=3)
    holding.add_keyframes(0, 0, 2)
    assert holding.end_frame == 0
    holding.add_keyframes(0, 2, 4)
    assert holding.end_frame == 1


def test_qualities_rise_even_where_they_are_unknown_or_odd() -> None:
    assert rising((30.0, 29.0, 31.0), (1.0, 1.0, 1.0)) == (30.0, 30.0, 31.0)
    guessed = rising((float("nan"), 30.0), (100.0, 300.0))
    assert list(guessed) == pytest.approx([24.0, 30.0])
    media = MadeMedia((SegmentSizes((1.0, 2.0), guessed, (5.0, 5.0), (0.1, 0.1)),))
    assert media.sizes(0).gains_db == pytest.approx((24.0, 6.0))
    assert media.sizes(0).slice_bytes == (1.0, 3.0)


def stills() -> MadeMedia:
    """A stream in which nothing moves."""
    every = SegmentSizes((0.0,), (30.0,), (1000.0,), (0.0,))
    return MadeMedia((every,), num_frames=40, segment_frames=10)


def test_a_forgotten_chain_is_no_gap() -> None:
    holding = Holding(stills(), 0)
    holding.add_keyframes(0, 0, 1)
    for birth in range(1, 10):
        holding.add(birth, 0, 1)
    holding.add_keyframes(10, 0, 1)
    holding.forget(10)
    assert holding.end_frame == 11
    holding.add(11, 0, 1)
    assert holding.end_frame == 12


class Once:
    """Sends the first keyframe, and then all changes at once."""

    mends = False

    def __init__(self) -> None:
        self._left: list[Send] = [SendSlices(range(1, 40), 0, 1), SendKeyframes(0, 0, 1)]

    def choose(self, context: DecisionContext) -> Send | None:
        return self._left.pop() if self._left else None


def test_what_takes_no_bytes_comes() -> None:
    result = simulate(stills(), Once(), Link([LinkStep(1.0, 1e6, 0.02)]), at_most_s=20)
    assert [arrival.num_bytes for arrival in result.arrivals] == [1000.0, 0.0]
