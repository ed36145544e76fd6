"""Updates of slots to the chunks of a stream: skip maps, changes, keyframes; and the motion of all
slots between two frames, however far apart.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from codec.arrays import Bytes, Longs
from codec.coders.coder import EncodedChunk
from codec.errors import InvalidError
from codec.lattice.lattice import States
from codec.slice import HIDDEN, Motion, Slice, window_births
from codec.splats import Splats

from .change import Newcomers, encode_change
from .decoder import SlotDecoder
from .skipmap import SkipMapHistory, encode_skip_map
from .slotlayout import ENDED, NEW, PREDICTED, SlotLayout, Update
from .state import EMPTY, ESCAPED, ON_LATTICE, Delta, Slots, encode_keyframe


@dataclass(frozen=True, slots=True)
class EncodedSlice:
    """A slice before the entropy coder."""

    birth: int
    skip_map: EncodedChunk
    changes: tuple[EncodedChunk, ...]
    """The change of each layer."""


@dataclass(frozen=True, slots=True)
class _Part:
    """The part of an update that concerns one layer."""

    layer: int
    slots: Slots
    predicted_rows: Longs
    new_rows: Longs
    ended_rows: Longs
    predicted: States
    new: Newcomers
    start_offsets: Bytes  # of the new


class SlotEncoder:
    """Takes the updates of a stream in order of birth and keeps what they make of the slots.

    What it refuses leaves it as it was.
    """

    def __init__(self, layout: SlotLayout) -> None:
        self.layout = layout
        self.next_birth = window_births(0, layout.swin_size).start
        """Birth of the update that comes next."""
        self.lanes = [
            [Slots(count, layout.sh_degree, EMPTY) for count in layout.slots]
            for _ in range(layout.swin_size)
        ]
        """The values of the slots, lane after lane, layer after layer."""
        self.history = SkipMapHistory(layout)

    @staticmethod
    def resumed(decoder: SlotDecoder) -> SlotEncoder:
        """An encoder that goes on after what `decoder`, which has all layers, has read."""
        if decoder.frame is None or decoder.num_layers != decoder.layout.num_layers:
            raise InvalidError("an encoder can only continue from a decoder that has all layers")
        own, made = decoder.copy(), SlotEncoder(decoder.layout)
        made.lanes, made.history, made.next_birth = own.lanes, own.history, decoder.frame + 1
        return made

    @staticmethod
    def opened(layout: SlotLayout, opening: Sequence[Update]) -> SlotEncoder:
        """An encoder that goes on after the updates `opening`, which say all that shows by then: of
        each lane the last one, in order of birth, and nothing in them is predicted."""
        made = SlotEncoder(layout)
        if len(opening) != layout.swin_size:
            raise InvalidError(f"{len(opening)} updates open {layout.swin_size} lanes")
        made.next_birth = opening[0].birth
        for update in opening:
            made.append(update)
        return made

    def copy(self) -> SlotEncoder:
        """Another encoder that holds the same."""
        made = SlotEncoder.__new__(SlotEncoder)
        made.layout, made.next_birth = self.layout, self.next_birth
        made.lanes = [list(lane) for lane in self.lanes]  # `append` replaces slots
        made.history = self.history.copy()
        return made

    def append(self, update: Update) -> EncodedSlice | None:
        """`encode`, and goes on to the slice of `update`."""
        birth, lane = update.birth, self.lanes[self.layout.lane(update.birth)]
        parts = self._checked(update)
        encoded = self._encoded(update, parts)
        for part in parts:
            slots = part.slots.copy()
            slots.advance(_delta(part))
            lane[part.layer] = slots
        if birth > 0:
            self.history.note(birth, update.statuses)
        self.next_birth = birth + 1
        return encoded

    def encode(self, update: Update) -> EncodedSlice | None:
        """The chunks of the slice of `update`, which is not yet taken in; None before frame 0. The
        slice of frame 0 keeps all, for what it brings is in the keyframe of frame 0."""
        return self._encoded(update, self._checked(update))

    def _encoded(self, update: Update, parts: list[_Part]) -> EncodedSlice | None:
        """See `encode`; parts: those of `update`."""
        birth = update.birth
        if birth < 0:
            return None
        if birth == 0:
            update = Update.keeping(birth, self.layout)
            parts = list(self._parts(update, self.lanes[self.layout.lane(birth)]))
        skip_map = encode_skip_map(self.layout, birth, update.statuses, self.history.of(birth))
        changes = (
            encode_change(
                part.layer,
                birth,
                part.slots.states.take(part.predicted_rows),
                part.predicted,
                part.new,
                part.start_offsets,
            )
            for part in parts
        )
        return EncodedSlice(birth, skip_map, tuple(changes))

    def keyframes(self) -> tuple[EncodedChunk, ...]:
        """The keyframe of each layer as it is now, at the first frame of a segment."""
        frame = self.next_birth - 1
        if frame < 0 or frame != self.layout.segment_start(frame):
            raise InvalidError(f"keyframe: frame {frame} is not the first of a segment")
        lanes = [
            self.lanes[self.layout.lane(birth)]
            for birth in window_births(frame, self.layout.swin_size)
        ]
        return tuple(
            encode_keyframe(self.layout, layer, frame, [lane[layer] for lane in lanes])
            for layer in range(self.layout.num_layers)
        )

    def _checked(self, update: Update) -> list[_Part]:
        """The parts of `update` upon the slots of its lane. Raises InvalidError."""
        if update.birth != self.next_birth:
            raise InvalidError(f"update born at {update.birth}, expected {self.next_birth}")
        update.check(self.layout)
        parts = list(self._parts(update, self.lanes[self.layout.lane(update.birth)]))
        for part in parts:
            conditions = part.slots.conditions[part.predicted_rows]
            if (conditions != ON_LATTICE).any():
                first = int(np.argmax(conditions != ON_LATTICE))
                why = "has escaped" if conditions[first] == ESCAPED else "is empty"
                raise InvalidError(
                    f"update born at {update.birth}: slot {part.predicted_rows[first]} of layer "
                    f"{part.layer} is predicted, but it {why}; make it a new one"
                )
        return parts

    def _parts(self, update: Update, lane: Sequence[Slots]) -> Iterator[_Part]:
        """The parts of `update`, which is checked, upon `lane`, one for each layer."""
        edges = self.layout.row_edges
        coded_before = escapes_before = 0
        for layer in range(self.layout.num_layers):
            statuses = update.statuses[edges[layer] : edges[layer + 1]]
            coded = np.flatnonzero(statuses >= PREDICTED)
            is_new = statuses[coded] == NEW
            part = slice(coded_before, coded_before + len(coded))
            states = update.states.take(part)
            escaped = update.escaped[part][is_new]
            escapes_end = escapes_before + int(np.count_nonzero(escaped))
            yield _Part(
                layer,
                lane[layer],
                coded[~is_new],
                coded[is_new],
                np.flatnonzero(statuses == ENDED),
                states.take(~is_new),
                Newcomers(
                    states.take(is_new),
                    escaped,
                    update.escapes.take(slice(escapes_before, escapes_end)),
                ),
                update.start_offsets[part][is_new],
            )
            coded_before, escapes_before = part.stop, escapes_end


def _delta(part: _Part) -> Delta:
    """The changes that `part` makes to its slots."""
    first_new = len(part.predicted)
    count, num_ended = first_new + len(part.new), len(part.ended_rows)
    conditions = np.full(count + num_ended, ON_LATTICE, np.uint8)
    conditions[count:] = EMPTY
    conditions[first_new:count][part.new.escaped] = ESCAPED
    starts = np.full(count + num_ended, HIDDEN, np.uint8)
    starts[:first_new] = 0
    starts[first_new:count] = part.start_offsets
    sh_degree = part.slots.states.sh_degree
    states = States.concatenate(
        [part.predicted, part.new.states, States.zeros(num_ended, sh_degree)]
    )
    if len(part.new.escapes):
        escaped = np.flatnonzero(conditions == ESCAPED)
        states.put(escaped, States.zeros(len(escaped), sh_degree))
    return Delta(
        np.concatenate([part.predicted_rows, part.new_rows, part.ended_rows]),
        conditions,
        states,
        starts,
        part.new_rows[part.new.escaped],
        part.new.escapes,
    )


def motion_between(
    before: Sequence[Slice], changes: Iterable[Slice], after: Sequence[Slice]
) -> Motion:
    """The motion from the frame of the window `before` to that of the window `after`.

    before, after: all whole slices of a window, oldest first, each with all slots of its lane.
    changes: the slices between them, with their motion. A slot that any of them gives to another
    Gaussian, or that jumps in one, does not go on. The rows count the slots of all lanes in the
    order of `after`, in which equally far ones are drawn.
    """
    swin_size, count = len(before), len(before[0].splats)
    frame, later = before[-1].birth, after[-1].birth
    renewed = np.zeros((swin_size, count), np.bool_)
    for slice in changes:
        if slice.rows is None or slice.motion is None:
            raise InvalidError(f"the slice born at {slice.birth} does not report its motion")
        goes_on = slice.motion.rows[~slice.motion.enters]
        renewed[slice.lane(swin_size), np.setdiff1d(slice.rows, goes_on)] = True
    lanes = [slice.lane(swin_size) for slice in after]
    held = {slice.lane(swin_size): slice for slice in before}
    first = [held[lane] for lane in lanes]
    return Motion.of(
        np.arange(swin_size * count, dtype=np.int32),
        Splats.concatenate([slice.splats for slice in first]),
        np.concatenate([slice.active(frame, swin_size) for slice in first]),
        Splats.concatenate([slice.splats for slice in after]),
        np.concatenate([slice.active(later, swin_size) for slice in after]),
        renewed[lanes].ravel(),
    )
