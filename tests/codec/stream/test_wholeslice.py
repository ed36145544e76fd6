"""A slice sent whole: every Gaussian arrives in the layer of its rank, and no other remains."""

from __future__ import annotations

from dataclasses import replace
from itertools import accumulate, pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from codec.arrays import Doubles
from codec.errors import InvalidError
from codec.lattice.forms import canonical, to_luma
from codec.lattice.lattice import Lattice, dequantise
from codec.slice import HIDDEN, Slice
from codec.slots.encoder import SlotEncoder
from codec.slots.slotlayout import ENDED, NEW, SlotLayout, Update
from codec.splats import SH_C0, Splats
from codec.stream.wholeslice import layer_counts, opacity_rank, whole_update
from tests.support.drawn import drawn_splats, same_splats
from tests.support.hostile import refused
from tests.support.slots.updates import small_layout
from tests.support.trained_like import trained_like_splats

SWIN_SIZE = 255
"""Large enough for a unique start offset, which identifies a Gaussian of a small slice."""

Case = tuple[Slice, SlotLayout]


@st.composite
def cases(draw: st.DrawFn) -> Case:
    """A slice with unique start offsets, and a layout with room for it."""
    slots = tuple(draw(st.lists(st.integers(1, 30), min_size=1, max_size=4)))
    splats = draw(drawn_splats(max_count=sum(slots)))
    rng = np.random.default_rng(draw(st.integers(0, 1 << 32)))
    splats.means[rng.random(len(splats)) < draw(st.sampled_from([0, 0.2, 1]))] *= 1e6
    offsets = rng.permutation(SWIN_SIZE)[: len(splats)].astype(np.uint8)
    birth = draw(st.integers(-SWIN_SIZE + 1, 1000))
    return Slice(birth, splats, offsets), small_layout(SWIN_SIZE, slots, splats.sh_degree)


def rows_of(update: Update, slice: Slice) -> list[int]:
    """Index in `slice` of each Gaussian of `update`."""
    places = {offset: row for row, offset in enumerate(slice.start_offsets.tolist())}
    return [places[offset] for offset in update.start_offsets.tolist()]


@given(cases(), st.booleans())
@settings(max_examples=40)
def test_each_gaussian_takes_a_slot_of_the_layer_of_its_rank(case: Case, exact: bool) -> None:
    slice, layout = case
    update = whole_update(slice, layout, opacity_rank, exact)
    update.check(layout)
    rows = rows_of(update, slice)
    assert update.birth == slice.birth
    assert sorted(rows) == list(range(len(slice.splats)))
    counts = layer_counts(len(rows), layout.slots)
    for (first, last), count in zip(pairwise(layout.row_edges), counts, strict=True):
        statuses = update.statuses[first:last].tolist()
        assert statuses == [NEW] * count + [ENDED] * (last - first - count)
    if exact:
        assert update.escaped.all()
        assert same_splats(update.escapes, slice.splats.take(np.array(rows, np.int64)))
    ranks = opacity_rank(slice.splats)[rows]
    for end in accumulate(counts):
        assert ranks[:end].min(initial=np.inf) >= ranks[end:].max(initial=-np.inf)


def assert_within_half_a_step(found: Splats, given_: Splats, lattice: Lattice) -> None:
    def close(a: Doubles, b: Doubles, step: float) -> None:
        assert (np.abs(a - b) <= 0.5001 * step + 4e-7 * np.abs(b).max(initial=1)).all()

    scales, quats = canonical(given_.log_scales, given_.quats)
    rgb = given_.sh.astype(float)
    if given_.sh_degree == 0:  # a colour below black is drawn black
        rgb = np.maximum(rgb, -0.5 / SH_C0)
    close(found.means.astype(float), given_.means.astype(float), lattice.position_m)
    close(found.log_scales.astype(float), scales, lattice.log_scale)
    close(found.quats[:, 1:].astype(float), quats[:, 1:], lattice.rotation)
    opacities = found.opacities.astype(float), given_.opacities.astype(float)
    close(*opacities, 1 / (lattice.opacity_levels - 1))
    close(to_luma(found.sh.astype(float)), to_luma(rgb), lattice.colour)


@given(cases())
@settings(max_examples=40)
def test_others_are_within_half_a_step_of_their_layer_or_escape(case: Case) -> None:
    slice, layout = case
    update = whole_update(slice, layout, opacity_rank)
    rows, end = np.array(rows_of(update, slice), np.int64), 0
    assert same_splats(update.escapes, slice.splats.take(rows[update.escaped]))
    for count, lattice in zip(layer_counts(len(rows), layout.slots), layout.lattices, strict=True):
        first, end = end, end + count
        escaped = update.escaped[first:end]
        assert (np.diff(escaped.astype(int)) >= 0).all()  # the escaped ones are last
        inside = np.arange(first, end)[~escaped]
        found = dequantise(update.states.take(inside), lattice)
        assert_within_half_a_step(found, slice.splats.take(rows[inside]), lattice)


def size_bytes(update: Update, layout: SlotLayout) -> int:
    encoder = SlotEncoder(layout)
    encoder.append(replace(update, birth=0))
    return sum(len(chunk.data) for chunk in encoder.keyframes())


def test_neighbours_follow_each_other_which_takes_fewer_bytes() -> None:
    """There are more Gaussians than are tried at a time, and all of them are there."""
    count = 3000
    splats = trained_like_splats(count)
    layout = SlotLayout(1, (count,), 0, (Lattice.suiting(splats),), 1)
    zeros = np.zeros(count, np.uint8)
    ordered, turned = (
        whole_update(Slice(0, one, zeros), layout, opacity_rank)
        for one in (splats, splats.take(np.arange(count)[::-1]))
    )
    assert not ordered.escaped.any()
    # For any order of the input.
    of_both = [sorted(update.states.positions.tolist()) for update in (ordered, turned)]
    assert of_both[0] == of_both[1]
    shuffle = np.random.default_rng(0).permutation(count)
    shuffled = replace(ordered, states=ordered.states.take(shuffle))
    assert size_bytes(ordered, layout) < 0.9 * size_bytes(shuffled, layout)


@given(cases(), st.booleans())
@settings(max_examples=20)
def test_what_is_hidden_is_left_out(case: Case, exact: bool) -> None:
    """As for slices of a reader, which have a row for each slot."""
    slice, layout = case
    offsets = np.where(np.arange(len(slice.splats)) % 3, slice.start_offsets, HIDDEN)
    some = Slice(slice.birth, slice.splats, offsets.astype(np.uint8))
    rows = np.flatnonzero(offsets != HIDDEN)
    fewer = Slice(slice.birth, slice.splats.take(rows), slice.start_offsets[rows])
    updates = [whole_update(one, layout, opacity_rank, exact) for one in (some, fewer)]
    assert same_splats(updates[0].escapes, updates[1].escapes)
    for name in ("statuses", "start_offsets", "escaped"):
        assert (getattr(updates[0], name) == getattr(updates[1], name)).all()
    assert (updates[0].states.attributes == updates[1].states.attributes).all()


@pytest.mark.parametrize("exact", [False, True])
def test_what_is_not_a_whole_slice_of_the_stream_is_refused(exact: bool) -> None:
    layout = small_layout(3, (5, 3), 0, 4)
    splats = trained_like_splats(9)
    offsets = np.zeros(9, np.uint8)
    few = Slice(0, splats.take(np.arange(2)), offsets[:2])
    wrongs = [
        (Slice(0, splats, offsets), "9 Gaussians, at most 8 a slice"),
        (replace(few, rows=np.array([0, 3], np.int32)), "a slice with rows is not whole"),
        (replace(few, splats=trained_like_splats(2, sh_degree=1)), "SH degree 1, not 0"),
    ]
    for wrong, message in wrongs:
        refused(InvalidError, message, whole_update, wrong, layout, opacity_rank, exact)
    late = replace(few, start_offsets=np.array([0, 3], np.uint8))
    with pytest.raises(InvalidError, match="start offset 3 of 3 frames"):
        whole_update(late, layout, opacity_rank, exact).check(layout)


def test_the_largest_slices_fit() -> None:
    for slots in ((1, (1 << 20) - 1), (1,) * 15 + ((1 << 20) - 15,), (349_525,) * 3):
        assert layer_counts(sum(slots), slots) == slots
        for count in (1, sum(slots) // 2, sum(slots) - 1):
            pairs = zip(layer_counts(count, slots), slots, strict=True)
            assert all(taken <= most for taken, most in pairs)
