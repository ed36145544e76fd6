"""Gaussians between two frames: at their ends exact, between them on the straight way."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from codec.errors import InvalidError
from codec.halfway import Motion
from codec.slots.slotdecoder import SlotDecoder
from codec.slots.slotencoder import SlotEncoder
from codec.slots.slotlayout import SlotLayout
from codec.slots.update import PREDICTED
from codec.splats import Splats
from tests.support.drawn import same_splats
from tests.support.hosted_streams import random_splats
from tests.support.slots.updates import patternless_updates, small_layout

SHARES = st.floats(0, 1, width=32)


def motion(seed: int, count: int = 9) -> Motion:
    rows = np.arange(count, dtype=np.int32) * 3
    return Motion(rows, random_splats(count, 1, seed), random_splats(count, 1, seed + 1))


@given(st.integers(0, 1000))
def test_the_ends_are_exact(seed: int) -> None:
    one = motion(seed)
    assert one.at(0.0) is one.before
    assert one.at(1.0) is one.after


@given(st.integers(0, 1000), SHARES)
def test_what_is_between_lies_on_the_straight_way(seed: int, share: float) -> None:
    one = motion(seed)
    found = one.at(share)
    for at in ("means", "log_scales", "logit_opacities", "sh"):
        first, last = getattr(one.before, at), getattr(one.after, at)
        expected = (1 - share) * first.astype(np.float64) + share * last
        assert np.allclose(getattr(found, at), expected, atol=1e-5)


@given(st.integers(0, 1000), SHARES)
def test_rotations_take_the_shorter_way_whatever_their_signs(seed: int, share: float) -> None:
    one = motion(seed)
    arrays = list(one.after.arrays)
    arrays[2] = -arrays[2]
    other = Motion(one.rows, one.before, Splats(*arrays))
    found, opposite = one.at(share).quats, other.at(share).quats
    cosines = np.abs((found * opposite).sum(1))
    assert np.allclose(cosines, np.linalg.norm(found, axis=1) * np.linalg.norm(opposite, axis=1))
    assert (np.linalg.norm(found, axis=1) > 0).all()


def test_two_that_cancel_out_still_turn_by_something() -> None:
    quats = np.array([[1, 0, 0, 0], [0, 0, 0, 0]], np.float32)
    before, after = random_splats(2, 0, 0), random_splats(2, 0, 1)
    first = Splats(before.means, before.log_scales, quats[:1].repeat(2, 0), *before.arrays[3:])
    last = Splats(after.means, after.log_scales, -quats[:1].repeat(2, 0), *after.arrays[3:])
    found = Motion(np.arange(2, dtype=np.int32), first, last).at(0.5).quats
    assert (np.linalg.norm(found, axis=1) > 0.9).all()


def test_parts_that_do_not_belong_together_are_refused() -> None:
    with pytest.raises(InvalidError, match="3 rows"):
        Motion(np.arange(3, dtype=np.int32), random_splats(2, 0, 0), random_splats(3, 0, 0))


@pytest.mark.parametrize("num_layers", [1, 2])
@pytest.mark.parametrize("layout", [small_layout(), small_layout(3, (6, 4), 1, 5)])
def test_a_decoder_says_what_its_predicted_slots_were(layout: SlotLayout, num_layers: int) -> None:
    encoder, decoder = SlotEncoder(layout), SlotDecoder(layout, num_layers)
    plain, moving = SlotDecoder(layout, num_layers), 0
    for update in patternless_updates(layout, 40, seed=4):
        encoded = encoder.append(update)
        if update.birth == 0:
            for layer, snapshot in enumerate(encoder.snapshots()[:num_layers]):
                decoder.load(snapshot.data, layer)
                plain.load(snapshot.data, layer)
        if encoded is None or update.birth <= 0:
            continue
        before = decoder.whole(update.birth - layout.swin_size)
        changes = [change.data for change in encoded.changes][:num_layers]
        made = decoder.apply(update.birth, encoded.mask.data, changes, with_motion=True)
        same = plain.apply(update.birth, encoded.mask.data, changes)
        assert same.motion is None
        assert same_splats(made.splats, same.splats)
        assert made.motion is not None
        assert made.rows is not None
        rows = made.motion.rows
        held = update.statuses[: sum(layout.slots[:num_layers])] == PREDICTED
        assert held[rows].all()
        assert same_splats(made.motion.before, before.splats.take(rows))
        places = np.searchsorted(made.rows, rows)
        assert (made.rows[places] == rows).all()
        assert same_splats(made.motion.after, made.splats.take(places))
        assert made.num_bytes > same.num_bytes or not len(rows)
        moving += len(rows)
    assert moving > 10
