"""Passing slices: with all of them, each frame equals the input; without any of them, the lasting
slots are known, integer for integer."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from codec.errors import CodecError, CorruptError
from codec.slice import Slice
from codec.slots.slotdecoder import SlotDecoder
from codec.slots.slotencoder import SlotEncoder
from codec.slots.slotlayout import SlotLayout
from codec.slots.slotstate import UNKNOWN
from codec.splats import Splats
from tests.support.drawn import same_splats
from tests.support.hostile import flips
from tests.support.slots.plain import Chunks, encoded_chunks
from tests.support.slots.updates import patternless_updates, small_layout


@dataclass(frozen=True)
class Twins:
    """The same updates with and without a temporal layer."""

    layout: SlotLayout
    chunks: Chunks
    frames: list[Splats]
    """All slots of each frame, from the stream without the temporal layer."""

    @staticmethod
    def of(
        period: int, slots: tuple[int, ...], segments: int, seed: int, wild: bool, calm: int
    ) -> Twins:
        length = period * segments
        plain = small_layout(1, slots, 0, length)
        layout = small_layout(1, slots, 0, length, period)
        updates = patternless_updates(plain, 2 * length + 1, seed, wild, calm)
        simple, frames = encoded_chunks(plain, updates), []
        decoder = SlotDecoder(plain)
        for data in simple.snapshots[0]:
            decoder.load(data)
        for birth in range(len(simple.masks)):
            if birth:
                decoder.apply(birth, *simple.slice(birth))
            frames.append(decoder.whole(birth).splats)
        return Twins(layout, encoded_chunks(layout, updates), frames)

    def joined(self, segment: int = 0, layers: int | None = None) -> SlotDecoder:
        """A decoder with the snapshots of a segment."""
        decoder = SlotDecoder(self.layout, layers)
        snapshots = self.chunks.snapshots[segment * self.layout.segment_frames]
        for data in snapshots[: decoder.num_layers]:
            decoder.load(data)
        return decoder

    def stays(self, birth: int) -> int:
        """The frame whose slots a passing slice of `birth` leaves unchanged."""
        return birth - birth % self.layout.temporal_period


twins = st.builds(
    Twins.of,
    period=st.sampled_from([2, 3, 4]),
    slots=st.sampled_from([(1,), (7,), (5, 3)]),
    segments=st.integers(1, 2),
    seed=st.integers(0, 1 << 32),
    wild=st.booleans(),
    calm=st.sampled_from([1, 4]),
)


def patched(shown: Splats, change: Slice) -> Splats:
    arrays = [array.copy() for array in shown.arrays]
    for array, new in zip(arrays, change.splats.arrays, strict=True):
        array[change.rows] = new
    return Splats(*arrays)


@given(twins, st.integers(0, 1))
@settings(max_examples=40)
def test_with_all_slices_each_frame_is_what_was_given(stream: Twins, segment: int) -> None:
    decoder = stream.joined(segment)
    shown = decoder.whole(decoder.frame or 0).splats
    for birth in range((decoder.frame or 0) + 1, len(stream.frames)):
        change = decoder.apply(birth, *stream.chunks.slice(birth), with_motion=True)
        assert same_splats(decoder.whole(birth).splats, stream.frames[birth])
        below = decoder.whole(birth, stream.layout.num_layers - 1).splats
        assert same_splats(below, stream.frames[stream.stays(birth)])
        assert same_splats(patched(shown, change), stream.frames[birth])
        assert change.motion is not None
        on = change.motion.rows[~change.motion.enters]
        assert same_splats(
            change.motion.before.take(np.flatnonzero(~change.motion.enters)), shown.take(on)
        )
        shown = stream.frames[birth]


@given(twins, st.integers(0, 1 << 32), st.booleans())
@settings(max_examples=40)
def test_any_may_be_missing(stream: Twins, seed: int, with_layer: bool) -> None:
    rng, layout = np.random.default_rng(seed), stream.layout
    decoder = stream.joined(0, layout.num_layers - (not with_layer))
    shown = decoder.whole(0).splats
    for birth in range(1, len(stream.frames)):
        mask, changes = stream.chunks.slice(birth)
        passes, missing = layout.is_passing(birth), bool(rng.random() < 0.5)
        given_changes: list[bytes | None] = [*changes[: decoder.num_layers]]
        if with_layer and missing:
            given_changes[-1] = None
        no_mask = passes and bool(rng.random() < 0.5)
        change = decoder.apply(birth, None if no_mask else mask, given_changes)
        wanted = birth if with_layer and not missing else stream.stays(birth)
        assert same_splats(decoder.whole(birth).splats, stream.frames[wanted])
        assert not any((slots.conditions == UNKNOWN).any() for slots in decoder.lanes[0])
        assert same_splats(patched(shown, change), stream.frames[wanted])
        shown = stream.frames[wanted]
        if with_layer and missing and changes[-1]:
            assert not decoder.late(birth, layout.num_layers - 1, changes[-1])


@given(twins, st.integers(0, 1 << 32))
@settings(max_examples=40)
def test_what_comes_late_ends_in_the_same_frames(stream: Twins, seed: int) -> None:
    rng, layout = np.random.default_rng(seed), stream.layout
    decoder, late = stream.joined(), list[tuple[int, int]]()
    for birth in range(1, layout.segment_frames):
        mask, changes = stream.chunks.slice(birth)
        lost = rng.random(len(changes) - 1) < 0.4
        late += [(birth, layer) for layer in np.flatnonzero(lost).tolist()]
        pairs = zip(lost, changes, strict=False)
        come = [None if gone else change for gone, change in pairs]
        decoder.apply(birth, mask, [*come, changes[-1]])
    for birth, layer in rng.permutation(np.array(late).reshape(-1, 2)).tolist():
        decoder.late(birth, layer, stream.chunks.changes[birth][layer])
    for birth in range(layout.segment_frames - 1, len(stream.frames)):
        if birth >= layout.segment_frames:
            decoder.apply(birth, *stream.chunks.slice(birth))
        assert same_splats(decoder.whole(birth).splats, stream.frames[birth])


@given(twins)
@settings(max_examples=20)
def test_a_writer_goes_on_after_a_passing_slice(stream: Twins) -> None:
    layout = stream.layout
    updates = patternless_updates(
        small_layout(1, layout.slots[:-1], 0, layout.segment_frames), 2 * layout.segment_frames, 3
    )
    whole, decoder = encoded_chunks(layout, updates), SlotDecoder(layout)
    for data in whole.snapshots[0]:
        decoder.load(data)
    for birth in range(1, layout.segment_frames):
        decoder.apply(birth, *whole.slice(birth))
    encoder = SlotEncoder.resumed(decoder)
    for update in updates[layout.segment_frames :]:
        made = encoder.append(update)
        assert made is not None
        assert (made.mask.data, [c.data for c in made.changes]) == whole.slice(update.birth)


def test_hostile_bytes_are_refused_and_leave_all_as_it_was() -> None:
    stream = Twins.of(2, (5, 3), 2, 7, False, 1)
    decoder = stream.joined()
    mask, changes = stream.chunks.slice(1)
    assert not mask
    assert not any(changes[:-1])
    before = decoder.whole(0).splats
    changing = stream.chunks.masks[2].replace(b"\x02\0\0\0", b"\x01\0\0\0", 1)
    with pytest.raises(CorruptError, match="mask: a passing slice does not keep all"):
        decoder.apply(1, changing, [None, None])
    for data in [*flips(changes[-1]), *(changes[-1][:n] for n in range(1, len(changes[-1])))]:
        copy = decoder.copy()
        try:
            copy.apply(1, mask, [*changes[:-1], data])
        except CodecError:
            assert copy.frame == 0
            assert same_splats(copy.whole(0).splats, before)
    decoder.apply(1, mask, changes)
    with pytest.raises(CorruptError, match="the slice born at 2 is none"):
        decoder.apply(2, stream.chunks.masks[2], [*stream.chunks.changes[2][:-1], changes[-1]])
