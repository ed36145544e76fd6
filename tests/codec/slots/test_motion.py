"""Gaussians between two frames: their motion, and a decoder that reports it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from codec.errors import InvalidError
from codec.slice import HIDDEN, JUMP_SIGMAS, Motion, jumps
from codec.slots.decoder import SlotDecoder
from codec.slots.encoder import SlotEncoder
from codec.slots.slotlayout import KEPT, PREDICTED, SlotLayout
from codec.splats import Splats
from tests.support.drawn import same_splats
from tests.support.hosted_streams import random_splats
from tests.support.slots.updates import patternless_updates, small_layout

SHARES = st.floats(0, 1, width=32)


def motion(seed: int, count: int = 9, enters: bool = False) -> Motion:
    rows = np.arange(count, dtype=np.int32) * 3
    first, last = random_splats(count, 1, seed), random_splats(count, 1, seed + 1)
    flags = np.full(count, enters)
    return Motion(rows, first, last, flags, random_splats(4, 1, seed + 2), rows[:4])


@given(st.integers(0, 1000), st.booleans())
def test_the_ends_are_exact(seed: int, enters: bool) -> None:
    one = motion(seed, enters=enters)
    assert one.at(1.0) is one.after
    assert len(one.leaving_at(1.0)) == 0
    assert same_splats(one.all_at(1.0), one.after)
    first = one.at(0.0)
    expected = np.zeros(9) if enters else one.before.opacities
    assert np.allclose(first.opacities, expected, atol=1e-6)
    assert all(
        np.array_equal(*ends) for ends in zip(first.arrays[:3], one.before.arrays[:3], strict=True)
    )
    assert np.allclose(one.leaving_at(0.0).opacities, one.leaving.opacities, atol=1e-6)


@given(st.integers(0, 1000), SHARES)
def test_what_is_between_lies_on_the_straight_way(seed: int, share: float) -> None:
    """And rotations take the shorter way, whatever their signs."""
    one = motion(seed)
    found = one.at(share)
    for at in ("means", "log_scales", "opacities", "sh"):
        first, last = getattr(one.before, at), getattr(one.after, at)
        expected = (1 - share) * first.astype(np.float64) + share * last
        assert np.allclose(getattr(found, at), expected, atol=1e-5)
    other = replace(one, after=replace(one.after, quats=-one.after.quats)).at(share)
    lengths = [np.linalg.norm(splats.quats, axis=1) for splats in (found, other)]
    assert np.allclose(np.abs((found.quats * other.quats).sum(1)), lengths[0] * lengths[1])
    assert (lengths[0] > 0).all()


def test_two_that_cancel_out_still_turn_by_something() -> None:
    quats = np.array([[1, 0, 0, 0]] * 2, np.float32)
    first, last = (replace(random_splats(2, 0, n), quats=q) for n, q in ((0, quats), (1, -quats)))
    rows, enters = np.arange(2, dtype=np.int32), np.zeros(2, np.bool_)
    found = Motion(rows, first, last, enters, Splats.empty(), rows[:0]).at(0.5).quats
    assert (np.linalg.norm(found, axis=1) > 0.9).all()
    with pytest.raises(InvalidError, match="2 rows"):
        Motion(rows, first, random_splats(3, 0, 0), enters, Splats.empty(), rows[:0])


@given(st.integers(0, 10_000), SHARES)
def test_no_slot_goes_where_neither_frame_has_a_gaussian(seed: int, share: float) -> None:
    """Slots go on, end, begin, jump, or get another Gaussian. Between the frames, a Gaussian is
    near its place in the frame before or after, and in between only if its slot goes on."""
    rng = np.random.default_rng(seed)
    count = 40
    before, after = random_splats(count, 0, seed), random_splats(count, 0, seed + 1)
    near = before.means + rng.normal(0, 0.01, before.means.shape).astype(np.float32)
    moves = rng.random(count) < 0.5
    after = Splats(np.where(moves[:, None], near, after.means), *after.arrays[1:])
    was_here, is_here, renewed = (rng.random(count) < p for p in (0.8, 0.8, 0.3))
    made = Motion.of(np.arange(count, dtype=np.int32), before, was_here, after, is_here, renewed)
    assert made.rows.tolist() == np.flatnonzero(is_here).tolist()
    jumped = jumps(before, after)
    on = was_here & is_here & ~renewed & ~jumped
    assert (made.enters == ~on[is_here]).all()
    assert len(made.leaving) == (was_here & ~on).sum()
    assert np.array_equal(made.leaving.means, before.means[made.left])
    found = made.at(share)
    sigma_m = np.exp(np.maximum(before.log_scales.max(1), after.log_scales.max(1)))
    away_m = np.linalg.norm(found.means - after.means[is_here], axis=1)
    assert (away_m <= JUMP_SIGMAS * sigma_m[is_here] * (1 + 1e-5)).all()
    assert (away_m[made.enters] <= 1e-5).all()
    # Gaussians are never more opaque than in the frames that have them.
    assert (found.opacities[made.enters] <= after.opacities[is_here][made.enters] + 1e-6).all()
    faded = made.leaving_at(share)
    assert share == 1 or (faded.opacities <= made.leaving.opacities + 1e-6).all()


@pytest.mark.parametrize("num_layers", [1, 2])
@pytest.mark.parametrize("layout", [small_layout(), small_layout(3, (6, 4), 1, 5)])
def test_a_decoder_reports_what_its_slots_were(layout: SlotLayout, num_layers: int) -> None:
    encoder, decoder = SlotEncoder(layout), SlotDecoder(layout, num_layers)
    plain, moving, left = SlotDecoder(layout, num_layers), 0, 0
    for update in patternless_updates(layout, 40, seed=4):
        encoded = encoder.append(update)
        if update.birth == 0:
            for layer, keyframe in enumerate(encoder.keyframes()[:num_layers]):
                decoder.load(keyframe.data, layer)
                plain.load(keyframe.data, layer)
        if encoded is None or update.birth <= 0:
            continue
        before = decoder.whole(update.birth - layout.swin_size)
        changes = [change.data for change in encoded.changes][:num_layers]
        made = decoder.apply(update.birth, encoded.skip_map.data, changes, with_motion=True)
        same = plain.apply(update.birth, encoded.skip_map.data, changes)
        assert same.motion is None
        assert same_splats(made.splats, same.splats)
        assert made.motion is not None
        assert made.rows is not None
        motion, width = made.motion, sum(layout.slots[:num_layers])
        held = before.start_offsets != HIDDEN
        places = np.searchsorted(made.rows, motion.rows)
        assert (made.rows[places] == motion.rows).all()
        assert (made.start_offsets[places] == 0).all()
        assert same_splats(motion.after, made.splats.take(places))
        on = motion.rows[~motion.enters]
        predicted = update.statuses[:width] == PREDICTED
        assert predicted[on].all()
        assert held[on].all()
        at = np.flatnonzero(~motion.enters)
        assert same_splats(motion.before.take(at), before.splats.take(on))
        # Earlier Gaussians that do not go on leave, unless they are kept.
        changes = update.statuses[:width] != KEPT
        changes[on] = False
        # Gaussians from a keyframe are handed out with the lane's next slice, and never fade.
        was_handed_out = update.birth > layout.swin_size
        gone = np.flatnonzero(held & changes & was_handed_out)
        assert same_splats(motion.leaving, before.splats.take(gone))
        assert motion.left.tolist() == gone.tolist()
        assert made.num_bytes > same.num_bytes or not len(motion.rows)
        moving, left = moving + len(on), left + len(gone)
    assert moving > 10
    assert left > 10
