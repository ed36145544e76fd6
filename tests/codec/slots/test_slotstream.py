"""Slots from update to Gaussian: every reader has the integers that section 7 defines."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from codec.lattice.lattice import dequantise
from codec.slice import HIDDEN, Slice, window_births
from codec.slots.slotdecoder import SlotDecoder
from codec.slots.slotencoder import SlotEncoder
from codec.slots.slotlayout import SlotLayout
from codec.slots.slotstate import EMPTY, ESCAPED, ON_LATTICE, UNKNOWN, Slots
from codec.slots.update import ENDED, NEW, PREDICTED, Update
from codec.splats import Splats
from tests.support.drawn import same_splats
from tests.support.slots.plain import Chunks, encoded_chunks
from tests.support.slots.updates import Model, patternless_updates, small_layout


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


def values(slots: Slots) -> list[str | tuple[str, bytes] | None]:
    """State of each slot, in the form of `Model`; "unknown" if it is not known."""
    found: list[str | tuple[str, bytes] | None] = []
    for row, condition in enumerate(slots.conditions):
        if condition in (UNKNOWN, EMPTY):
            found.append("unknown" if condition == UNKNOWN else None)
        elif condition == ESCAPED:
            at = slots.escape_rows.tolist().index(row)
            one = slots.escapes.take(np.array([at]))
            found.append(("escape", b"".join(array.tobytes() for array in one.arrays)))
        else:
            state = slots.states.take(np.array([row]))
            found.append(("lattice", state.positions.tobytes() + state.attributes.tobytes()))
    return found


def lane_values(
    decoder: SlotDecoder | SlotEncoder, lane: int
) -> list[str | tuple[str, bytes] | None]:
    return [value for slots in decoder.lanes[lane] for value in values(slots)]


def onto(change: Slice, before: Slice) -> Slice:
    """The whole slice after `change`, with rows, is applied to the whole slice before it."""
    arrays = [array.copy() for array in before.splats.arrays]
    for array, new in zip(arrays, change.splats.arrays, strict=True):
        array[change.rows] = new
    offsets = np.where(before.start_offsets == HIDDEN, HIDDEN, 0).astype(np.uint8)
    offsets[change.rows] = change.start_offsets
    return Slice(change.birth, Splats(*arrays), offsets)


def joined(stream: Encoded, frame: int, layers: int | None = None) -> SlotDecoder:
    """A decoder that starts from the snapshots of the segment of `frame`."""
    decoder = SlotDecoder(stream.layout, layers)
    first = stream.layout.segment_start(frame)
    for data in stream.chunks.snapshots[first][: decoder.num_layers]:
        decoder.load(data)
    for birth in range(first + 1, frame + 1):
        decoder.apply(
            birth, stream.chunks.masks[birth], stream.chunks.changes[birth][: decoder.num_layers]
        )
    return decoder


@given(streams)
@settings(max_examples=40)
def test_a_reader_that_has_all_has_what_was_given(stream: Encoded) -> None:
    model, decoder, last = (
        Model(stream.layout),
        SlotDecoder(stream.layout),
        len(stream.chunks.masks),
    )
    layout = stream.layout
    for update in stream.updates:
        model.take(update)
        if update.birth == 0:
            for data in stream.chunks.snapshots[0]:
                decoder.load(data)
            decoder.hand_out(0)
        elif update.birth > 0:
            lane = layout.lane(update.birth)
            before = decoder.whole(update.birth - layout.swin_size)
            change = decoder.apply(update.birth, *stream.chunks.slice(update.birth))
            whole = decoder.whole(update.birth)
            assert change.rows is not None
            assert change.rows.tolist() == np.flatnonzero(update.statuses).tolist()
            patched = onto(change, before)
            assert same_splats(patched.splats, whole.splats)
            assert (patched.start_offsets == whole.start_offsets).all()
            assert lane_values(decoder, lane) == [
                model.held[lane, row] for row in range(layout.num_slots)
            ]
    assert decoder.frame == last - 1


@given(streams)
@settings(max_examples=30)
def test_a_join_at_any_frame_equals_playing_from_the_start(stream: Encoded) -> None:
    layout = stream.layout
    player = joined(stream, 0)
    for frame in range(len(stream.chunks.masks)):
        if frame:
            player.apply(frame, *stream.chunks.slice(frame))
        for layers in {1, layout.num_layers}:
            seeker = joined(stream, frame, layers)
            for lane in range(layout.swin_size):
                whole = lane_values(player, lane)[: layout.row_edges[layers]]
                assert lane_values(seeker, lane) == whole
            windows = player.window(frame, layers), seeker.window(frame)
            assert [part.birth for part in windows[0]] == list(
                window_births(frame, layout.swin_size)
            )
            for played, sought in zip(*windows, strict=True):
                assert same_splats(played.splats, sought.splats)
                for f in range(frame, played.birth + layout.swin_size):
                    shown_then = [part.active(f, layout.swin_size) for part in (played, sought)]
                    assert (shown_then[0] == shown_then[1]).all()


@given(streams)
@settings(max_examples=20)
def test_a_snapshot_of_what_was_read_is_the_one_that_was_written(stream: Encoded) -> None:
    decoder = SlotDecoder(stream.layout)
    encoder = SlotEncoder(stream.layout)
    for first, snapshots in stream.chunks.snapshots.items():
        decoder.clear()
        for data in snapshots:
            decoder.load(data)
        encoder.lanes, encoder.next_birth = decoder.lanes, first + 1
        assert [chunk.data for chunk in encoder.snapshots()] == snapshots


class Reader:
    """Section 7 applied to updates: the state of a reader with only some packets."""

    def __init__(self, stream: Encoded, layers: int) -> None:
        self.stream, self.layers = stream, layers

    def values(self, frame: int, present: set[tuple[int, int]], lane: int) -> list[object]:
        """States of the slots of `lane` in `frame` if, of the changes after frame 0, only those in
        `present`, (birth, layer), have arrived."""
        layout = self.stream.layout
        model = Model(layout)
        rows = layout.row_edges[self.layers]
        layer_of = np.repeat(np.arange(layout.num_layers), layout.slots)
        unknown: set[int] = set()
        for update in self.stream.updates:
            if update.birth > frame:
                break
            model.take(update)
            if layout.lane(update.birth) != lane or update.birth < 1:
                continue
            for row, status in enumerate(update.statuses):
                here = (update.birth, int(layer_of[row])) in present
                if status == ENDED or (status == NEW and here):
                    unknown.discard(row)
                elif status in (PREDICTED, NEW) and not here:
                    unknown.add(row)
        return ["unknown" if row in unknown else model.held[lane, row] for row in range(rows)]


def steps(stream: Encoded, seed: int) -> Iterator[tuple[int, set[int], list[tuple[int, int]]]]:
    """For each frame, the missing layers, and the (birth, layer) that arrive late after it."""
    rng = np.random.default_rng(seed)
    waiting: list[tuple[int, int]] = []
    for birth in range(1, len(stream.chunks.masks)):
        missing = set(np.flatnonzero(rng.random(stream.layout.num_layers) < 0.4).tolist())
        waiting += [(birth, layer) for layer in missing]
        rng.shuffle(waiting)
        coming = [waiting.pop() for _ in range(rng.integers(0, len(waiting) + 1))]
        yield birth, missing, coming


@given(streams, st.integers(0, 1 << 32))
@settings(max_examples=60)
def test_missing_and_late_packets(stream: Encoded, seed: int) -> None:
    layout = stream.layout
    decoder, reader = joined(stream, 0), Reader(stream, layout.num_layers)
    present: set[tuple[int, int]] = set()
    shown = {layout.lane(whole.birth): whole for whole in decoder.window(0)}
    for birth, missing, coming in steps(stream, seed):
        changes = stream.chunks.changes[birth]
        altered = decoder.apply(
            birth,
            stream.chunks.masks[birth],
            [None if layer in missing else data for layer, data in enumerate(changes)],
        )
        # The slices handed out update their lane, including late changes.
        lane = layout.lane(birth)
        shown[lane] = onto(altered, shown[lane])
        assert same_splats(shown[lane].splats, decoder.whole(birth).splats)
        assert (shown[lane].start_offsets == decoder.whole(birth).start_offsets).all()
        present |= {(birth, n) for n in range(layout.num_layers) if n not in missing}
        for lane in range(layout.swin_size):
            assert lane_values(decoder, lane) == reader.values(birth, present, lane)
        for late_birth, layer in coming:
            lane = layout.lane(late_birth)
            before = lane_values(decoder, lane)
            if not decoder.late(late_birth, layer, stream.chunks.changes[late_birth][layer]):
                assert lane_values(decoder, lane) == before
            present.add((late_birth, layer))
            assert lane_values(decoder, lane) == reader.values(birth, present, lane)
            assert not decoder.late(late_birth, layer, b"any")


@given(streams, st.integers(0, 1 << 32))
@settings(max_examples=30)
def test_a_layer_that_is_left_out_is_taken_up_again_by_a_snapshot(
    stream: Encoded, seed: int
) -> None:
    layout, rng = stream.layout, np.random.default_rng(seed)
    decoder, player = joined(stream, 0), joined(stream, 0)
    layers = layout.num_layers
    for birth in range(1, len(stream.chunks.masks)):
        player.apply(birth, *stream.chunks.slice(birth))
        decoder.apply(birth, stream.chunks.masks[birth], stream.chunks.changes[birth][:layers])
        if birth % layout.segment_frames == 0:
            wanted = int(rng.integers(1, layout.num_layers + 1))
            for layer in range(layers, wanted):
                decoder.load(stream.chunks.snapshots[birth][layer])
            layers = wanted
        for lane in range(layout.swin_size):
            rows = layout.row_edges[layers]
            assert lane_values(decoder, lane)[:rows] == lane_values(player, lane)[:rows]


@given(streams)
@settings(max_examples=20)
def test_what_shows_starts_when_it_was_told(stream: Encoded) -> None:
    layout = stream.layout
    starts = np.full((layout.swin_size, layout.num_slots), 1 << 20)
    decoder = SlotDecoder(layout)
    for update in stream.updates:
        lane, birth = layout.lane(update.birth), update.birth
        coded = np.flatnonzero(update.statuses >= PREDICTED)
        starts[lane][update.statuses == ENDED] = 1 << 20
        starts[lane][coded] = birth + update.start_offsets.astype(int)
        if birth == 0:
            for data in stream.chunks.snapshots[0]:
                decoder.load(data)
        elif birth > 0:
            decoder.apply(birth, *stream.chunks.slice(birth))
        if birth >= 0:
            for part in decoder.window(birth):
                for frame in range(birth, part.birth + layout.swin_size):
                    wanted = starts[layout.lane(part.birth)] <= frame
                    assert (part.active(frame, layout.swin_size) == wanted).all()


def test_gaussians_are_those_of_the_lattice_of_their_layer() -> None:
    stream = encoded(small_layout(2, (40, 30), 1), 9, 3)
    decoder = joined(stream, 8)
    for part in decoder.window(8):
        for layer, lattice in enumerate(stream.layout.lattices):
            slots = decoder.lanes[stream.layout.lane(part.birth)][layer]
            rows = np.arange(*stream.layout.row_edges[layer : layer + 2])
            found, wanted = part.splats.take(rows), dequantise(slots.states, lattice)
            kinds = slots.conditions
            for array, expected, escaped in zip(
                found.arrays, wanted.arrays, slots.escapes.arrays, strict=True
            ):
                inside = kinds == ON_LATTICE
                assert array[inside].tobytes() == expected[inside].tobytes()
                assert array[slots.escape_rows].tobytes() == escaped.tobytes()
            gone = kinds == EMPTY
            assert gone.any()
            assert (found.quats[gone] == (1, 0, 0, 0)).all()
            others = (found.means, found.log_scales, found.logit_opacities, found.sh)
            assert not any(array[gone].any() for array in others)
            assert (part.start_offsets[rows][gone] == HIDDEN).all()
