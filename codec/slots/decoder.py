"""Skip maps, changes and keyframes to Gaussians (codec/FORMAT.md, section 7), in any order of
arrival: while something of a layer of a lane is missing, a log keeps what came after it.

Rule: any bytes give a value or a CodecError that leaves everything as it was; memory goes by the
layout.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field

import numpy as np

from codec.arrays import Bytes, Flags, Ints, Longs
from codec.errors import CodecError, CorruptError, InvalidError
from codec.slice import Slice, window_births
from codec.splats import Splats

from .change import decode_change
from .skipmap import SkipMapHistory, decode_skip_map
from .slotlayout import BIRTH_AT, KEPT, LAYER_AT, NEW, PREDICTED, SlotLayout
from .state import UNKNOWN, Delta, HeldSlots, Slots, decode_keyframe, empty_arrays, holds


@dataclass(slots=True)
class SlotLog:
    """A layer of a lane since something of it was missing: the slices to apply again when it
    comes."""

    before: Slots | None
    """The slots before those slices; None if all were unknown."""
    since: dict[int, tuple[Bytes, bytes | None]] = field(default_factory=dict)
    """By birth the statuses and the change of every slice of the lane since then."""

    @property
    def num_bytes(self) -> int:
        changes = sum(len(change) for _, change in self.since.values() if change is not None)
        before = 0 if self.before is None else self.before.num_bytes
        return before + sum(s.nbytes for s, _ in self.since.values()) + changes

    @property
    def is_waiting(self) -> bool:
        """Whether any change is missing."""
        return any(map(self.waits_for, self.since))

    def waits_for(self, birth: int) -> bool:
        """Whether the change of `birth` is missing, and would alter something."""
        statuses, change = self.since.get(birth, (None, None))
        return statuses is not None and change is None and bool((statuses >= PREDICTED).any())


Data = bytes | memoryview

Blamed = Callable[[CodecError, int | None], CodecError]


def _as_it_is(error: CodecError, layer: int | None) -> CodecError:
    return error


MIN_LOG_BYTES = 1 << 24
"""Smallest bound on the bytes kept for late packets."""

LOG_SHARE = 6
"""The bound as a multiple of the bytes of the slots, where that is more than MIN_LOG_BYTES.
Measured: while the keyframes of three of four layers are missing, a segment of 30 frames that
changes 30 % of the slots in each keeps about 4 times their bytes."""


class SlotDecoder:
    """A reader's slots of layers 0..num_layers-1, from one frame to the next.

    Load the keyframes of a segment's first frame, then apply the slices born after it one by one.
    Layers that were not loaded are unknown, and hidden.
    """

    def __init__(self, layout: SlotLayout, num_layers: int | None = None) -> None:
        self.layout = layout
        self.num_layers = layout.num_layers if num_layers is None else num_layers
        if not 1 <= self.num_layers <= layout.num_layers:
            raise InvalidError(f"{num_layers} layers of {layout.num_layers}")
        self.clear()

    def clear(self) -> None:
        """Forgets all, so that a keyframe of any segment can be loaded."""
        layout = self.layout
        self.frame: int | None = None
        """Birth of the slice that was applied last; None before the first keyframe."""
        self.joined: int | None = None
        """The frame whose keyframe came first."""
        self.lanes = [
            [Slots(count, layout.sh_degree, UNKNOWN) for count in layout.slots[: self.num_layers]]
            for _ in range(layout.swin_size)
        ]
        """The values of the slots, lane after lane, layer after layer."""
        self.history = SkipMapHistory(layout)
        self._logs: dict[tuple[int, int], SlotLog] = {}
        """By lane and layer, the oldest first."""
        self._said: dict[int, Bytes] = {}
        """By birth the statuses of this segment's slices, for a keyframe that comes late."""
        self._pending: dict[tuple[int, int], Flags] = {}
        """By lane and layer the slots that keyframes and late changes have altered since the lane
        was handed out."""

    def copy(self) -> SlotDecoder:
        """Another decoder that holds the same, without what late changes need."""
        made = SlotDecoder(self.layout, self.num_layers)
        made.frame, made.joined = self.frame, self.joined
        made.lanes = [[slots.copy() for slots in lane] for lane in self.lanes]
        made.history = self.history.copy()
        return made

    def load(self, data: Data, layer: int | None = None, frame: int | None = None) -> bool:
        """Takes in the keyframe `data`, in place of what is here of its layer.

        layer, frame: which keyframe it should be; None takes that of any layer, and the first one
        of any segment, then that of the segment of the last slice. It may come late, after slices
        of its segment, and so may the changes since.
        Gives whether it is of use: that of an earlier segment is not, nor one of what is here.
        """
        keyframe = decode_keyframe(self.layout, data)
        if frame is None and self.frame is not None:
            frame = self.layout.segment_start(self.frame)
        if frame is not None and keyframe.frame != frame:
            raise CorruptError(
                f"keyframe: of frame {keyframe.frame} where that of {frame} belongs", BIRTH_AT
            )
        if layer is not None and keyframe.layer != layer:
            raise CorruptError(
                f"keyframe: of layer {keyframe.layer} where that of {layer} belongs", LAYER_AT
            )
        if self.frame is not None and keyframe.frame > self.frame:
            raise InvalidError(f"the slices have come to {self.frame}, the keyframe to {frame}")
        if keyframe.layer >= self.num_layers:
            raise InvalidError(f"keyframe: of layer {keyframe.layer}, held are {self.num_layers}")
        if self.frame is None:
            self.frame = self.joined = keyframe.frame
        if keyframe.frame != self.layout.segment_start(self.frame):
            return False
        births, used = window_births(keyframe.frame, self.layout.swin_size), False
        for birth, slots in zip(births, keyframe.lanes, strict=True):
            lane = self.layout.lane(birth)
            since = range(birth + self.layout.swin_size, self.frame + 1, self.layout.swin_size)
            on_time = keyframe.frame == self.frame
            if on_time or self._can_use_late(lane, keyframe.layer, since):
                self._begin_anew(lane, keyframe.layer, slots, since)
                used = True
        return used

    def _can_use_late(self, lane: int, layer: int, births: range) -> bool:
        """Whether a keyframe from before `births` adds to a layer of a lane: something is unknown
        that did not go missing since, and no skip map is missing, without which all of it would
        be."""
        if any(birth not in self._said for birth in births):
            return False
        log = self._logs.get((lane, layer))
        slots: Slots | None = self.lanes[lane][layer]
        if log is not None and min(log.since) in births:
            slots = log.before
        return slots is None or slots.has_unknown

    def _begin_anew(self, lane: int, layer: int, slots: Slots, births: range) -> None:
        """Puts `slots` in place of a layer of a lane, and applies what is known of `births`."""
        known = self._logs.pop((lane, layer), None)
        log = SlotLog(slots)
        for birth in births:
            statuses = self._by_layer(self._said[birth])[layer]
            change = None if known is None else known.since.get(birth, (None, None))[1]
            log.since[birth] = statuses, change
        self._logs[lane, layer] = log
        self._replay(lane, layer, log.since, None)
        self._pending[lane, layer] = np.ones(len(slots), np.bool_)

    def apply(
        self,
        birth: int,
        skip_map: Data | None,
        changes: Sequence[Data | None],
        blamed: Blamed = _as_it_is,
        with_motion: bool = False,
    ) -> Slice:
        """Goes on by the slice born at `birth`, which follows the last one.

        changes: of layers 0, 1, ...; None for one that is missing, which may come `late`. Layers
        behind the last are not expected.
        skip_map: None if it is missing. All slots of the lane are unknown then, and the changes are
        of no use. Later skip maps of the lane in this segment are not read, and count as missing,
        too, unless it was that of the segment's first frame.
        blamed: makes of an error the one that is raised, given the layer of the change at fault, or
        None if it is the skip map.
        with_motion: whether the slice says where its Gaussians come from, and which ones leave.
        Gives the slots that changed since the lane's slice before, by late changes and keyframes,
        too, as a slice with rows: row r is slot r of the lane, counted over all layers."""
        if self.frame is None or birth != self.frame + 1:
            last = "nothing" if self.frame is None else f"the slice born at {self.frame}"
            raise InvalidError(f"the slice born at {birth} does not follow {last}")
        if len(changes) > self.num_layers:
            raise InvalidError(f"{len(changes)} changes for {self.num_layers} layers")
        if skip_map is None or not self.history.is_readable(birth):
            return self._lose_lane(birth)
        lane = self.layout.lane(birth)
        statuses, deltas = self._read(birth, skip_map, changes, blamed)
        parts = self._by_layer(statuses)
        changed = [part != KEPT for part in parts]
        held = self._held(lane, parts) if with_motion else None
        for layer, delta in enumerate(deltas):
            slots = self.lanes[lane][layer]
            if layer < len(changes):
                self._remember(birth, layer, slots, parts[layer], changes[layer])
            else:
                self._logs.pop((lane, layer), None)
            slots.advance(delta)
            self._drop_if_complete(lane, layer)
        self.history.note(birth, statuses)
        self._go_on(birth, statuses)
        slice = self._changed(birth, changed)
        return slice if held is None else held.with_motion(slice)

    def _held(self, lane: int, parts: list[Bytes]) -> HeldSlots:
        """The Gaussians that players got last for the slots of `lane` that change; parts: their
        statuses, layer after layer."""
        rows, here, others = [], [], []
        for layer, slots in enumerate(self.lanes[lane]):
            changes, pending = parts[layer] != KEPT, self._pending.get((lane, layer))
            if pending is not None:
                changes &= ~pending
            rows.append(np.flatnonzero(changes))
            here.append(holds(slots.conditions[rows[-1]]))
            others.append(parts[layer][rows[-1]] != PREDICTED)
        numbers, splats, _ = self._drawn(lane, rows)
        return HeldSlots(numbers, splats, np.concatenate(here), np.concatenate(others))

    def _go_on(self, birth: int, statuses: Bytes | None) -> None:
        """Notes that the slices have come to `birth`; statuses: None if its skip map is missing."""
        if birth == self.layout.segment_start(birth):
            self._said = {}
            # The keyframes of the segment before can no longer come: only changes can.
            self._logs = {key: log for key, log in self._logs.items() if log.is_waiting}
        elif statuses is not None:
            self._said[birth] = statuses
        self.frame = birth
        while self._is_too_much(self.said_bytes):
            del self._said[next(iter(self._said))]

    def _is_too_much(self, log_bytes: int) -> bool:
        """Whether the bytes kept for late packets are over their bound."""
        return log_bytes > MIN_LOG_BYTES and log_bytes > LOG_SHARE * self._state_bytes()

    def _changed(self, birth: int, changed: list[Flags]) -> Slice:
        """Changes to the lane of `birth` since they were handed out last: in each layer those that
        its slice has `changed`, and what waited to be handed out."""
        lane = self.layout.lane(birth)
        for layer in range(self.num_layers):
            pending = self._pending.pop((lane, layer), None)
            if pending is not None:
                changed[layer] |= pending
        return self._slice(birth, map(np.flatnonzero, changed), with_rows=True)

    def statuses(
        self, birth: int, skip_map: Data, changes: Sequence[Data | None], blamed: Blamed = _as_it_is
    ) -> Bytes:
        """(S,) what the slice born at `birth` says of the slots of its lane; checks the changes,
        and applies nothing."""
        return self._read(birth, skip_map, changes, blamed)[0]

    def _read(
        self, birth: int, skip_map: Data, changes: Sequence[Data | None], blamed: Blamed
    ) -> tuple[Bytes, list[Delta]]:
        """The statuses of a slice, and what it makes of each layer."""
        at_fault: int | None = None
        deltas = []
        try:
            statuses = decode_skip_map(self.layout, birth, skip_map, self.history.of(birth))
            parts = self._by_layer(statuses)
            for layer, slots in enumerate(self.lanes[self.layout.lane(birth)]):
                at_fault = layer
                change = changes[layer] if layer < len(changes) else None
                deltas.append(self._delta(birth, layer, slots, parts[layer], change))
        except CodecError as error:
            raise blamed(error, at_fault) from error
        return statuses, deltas

    def _lose_lane(self, birth: int) -> Slice:
        """Goes on by a slice whose skip map is not at hand."""
        lane, sh_degree = self.layout.lane(birth), self.layout.sh_degree
        counts = self.layout.slots[: self.num_layers]
        self.lanes[lane] = [Slots(count, sh_degree, UNKNOWN) for count in counts]
        for layer in range(self.num_layers):
            self._logs.pop((lane, layer), None)
        self.history.note(birth, None)
        self._go_on(birth, None)
        return self._changed(birth, [np.ones(count, np.bool_) for count in counts])

    def late(self, birth: int, layer: int, change: Data) -> bool:
        """Takes in a change that was missing when its slice was applied.

        Gives whether it was still of use; the lane's next slice brings what it altered. A change
        after it that does not fit what the slots turn out to hold counts as missing.
        """
        lane = self.layout.lane(birth)
        log = self._logs.get((lane, layer))
        if log is None or not log.waits_for(birth):
            return False
        since = dict(log.since)
        since[birth] = since[birth][0], bytes(change)
        self._replay(lane, layer, since, birth)
        altered = [statuses != KEPT for known, (statuses, _) in since.items() if known >= birth]
        if (lane, layer) in self._pending:
            altered.append(self._pending[lane, layer])
        self._pending[lane, layer] = np.logical_or.reduce(altered)
        return True

    def _replay(
        self,
        lane: int,
        layer: int,
        since: dict[int, tuple[Bytes, bytes | None]],
        checked: int | None,
    ) -> None:
        """Applies `since` to a layer of a lane as it was before its log began. checked: the birth
        whose change raises if it does not fit; any other counts as missing then."""
        log = self._logs[lane, layer]
        slots = self._replayed(log.before, layer, since, checked)
        self.lanes[lane][layer] = slots
        log.since = since
        self._drop_if_complete(lane, layer)

    def _replayed(
        self,
        before: Slots | None,
        layer: int,
        since: dict[int, tuple[Bytes, bytes | None]],
        checked: int | None = None,
    ) -> Slots:
        """The slots `before` after the changes `since`; see `_replay`."""
        if before is None:
            slots = Slots(self.layout.slots[layer], self.layout.sh_degree, UNKNOWN)
        else:
            slots = before.copy()
        for birth, (statuses, change) in since.items():
            try:
                delta = self._delta(birth, layer, slots, statuses, change)
            except CodecError:
                if birth == checked:
                    raise
                delta = self._delta(birth, layer, slots, statuses, None)
            slots.advance(delta)
        return slots

    def whole(self, birth: int, num_layers: int | None = None) -> Slice:
        """The slice born at `birth`, one of the last swin_size, of layers 0..num_layers-1: all
        slots of its lane, hidden where there is no Gaussian."""
        if self.frame is None or birth not in window_births(self.frame, self.layout.swin_size):
            raise InvalidError(
                f"the slice born at {birth} is not one of the window of {self.frame}"
            )
        layers = self.num_layers if num_layers is None else num_layers
        if not 1 <= layers <= self.num_layers:
            raise InvalidError(f"{layers} layers of {self.num_layers}")
        rows = [np.arange(count) for count in self.layout.slots[:layers]]
        return self._slice(birth, rows, with_rows=False)

    def window(self, frame: int, num_layers: int | None = None) -> list[Slice]:
        """The swin_size slices that show at `frame`, the one that was applied last."""
        if frame != self.frame:
            raise InvalidError(f"the slices have come to {self.frame}, not {frame}")
        births = window_births(frame, self.layout.swin_size)
        return [self.whole(birth, num_layers) for birth in births]

    def hand_out(self, frame: int) -> list[Slice]:
        """The window of `frame`, as for a renderer that has nothing yet: what `apply` gives follows
        on it."""
        self._pending.clear()
        return self.window(frame)

    def _by_layer(self, statuses: Bytes) -> list[Bytes]:
        edges = self.layout.row_edges
        return [statuses[edges[n] : edges[n + 1]] for n in range(self.num_layers)]

    def _delta(
        self, birth: int, layer: int, slots: Slots, statuses: Bytes, change: Data | None
    ) -> Delta:
        if change is None:
            return slots.delta(statuses, None)
        predicted = int(np.count_nonzero(statuses == PREDICTED))
        new = int(np.count_nonzero(statuses == NEW))
        return slots.delta(
            statuses, decode_change(self.layout, layer, birth, change, predicted, new)
        )

    def _remember(
        self, birth: int, layer: int, slots: Slots, statuses: Bytes, change: Data | None
    ) -> None:
        """Logs what a late change or keyframe needs, before the slice is applied to `slots`."""
        key = self.layout.lane(birth), layer
        if key not in self._logs:
            is_missing = change is None and bool((statuses >= PREDICTED).any())
            if not is_missing and not slots.has_unknown:
                return
            self._logs[key] = SlotLog(slots.copy() if (slots.conditions != UNKNOWN).any() else None)
        kept = None if change is None else bytes(change)
        self._logs[key].since[birth] = statuses, kept
        while self._logs and self._is_too_much(self.log_bytes):
            self._shorten_oldest_log()

    def _shorten_oldest_log(self) -> None:
        """Gives up what only late packets of earlier segments need, or the whole log."""
        assert self.frame is not None
        (lane, layer), log = next(iter(self._logs.items()))
        del self._logs[lane, layer]
        start = self.layout.segment_start(self.frame)
        earlier = {birth: said for birth, said in log.since.items() if birth <= start}
        later = {birth: said for birth, said in log.since.items() if birth > start}
        if earlier and later:
            self._logs[lane, layer] = SlotLog(self._replayed(log.before, layer, earlier), later)

    def _drop_if_complete(self, lane: int, layer: int) -> None:
        """Drops the log of a layer of a lane that nothing late can alter."""
        log = self._logs.get((lane, layer))
        if log is None or log.is_waiting:
            return
        can_fill = log.before is None or log.before.has_unknown
        if not can_fill or not self.lanes[lane][layer].has_unknown:
            del self._logs[lane, layer]

    @property
    def log_bytes(self) -> int:
        """Bytes kept only because changes, or the keyframes before them, may come late."""
        return sum(log.num_bytes for log in self._logs.values())

    @property
    def said_bytes(self) -> int:
        """Bytes held only because keyframes may come late."""
        return len(self._said) * self.layout.num_slots

    def _state_bytes(self) -> int:
        return sum(slots.num_bytes for lane in self.lanes for slots in lane)

    def _slice(self, birth: int, rows: Iterable[Longs], with_rows: bool) -> Slice:
        """The slots `rows` of each layer in the lane of `birth`."""
        numbers, splats, starts = self._drawn(self.layout.lane(birth), list(rows))
        return Slice(birth, splats, starts, numbers if with_rows else None)

    def _drawn(self, lane: int, rows: list[Longs]) -> tuple[Ints, Splats, Bytes]:
        """The slots `rows` of each layer of a lane: their numbers, counted over all layers, what
        they hold and their start offsets."""
        edges = self.layout.row_edges
        ends = np.cumsum([0, *map(len, rows)])
        arrays = empty_arrays(ends[-1], self.layout.sh_degree)
        starts = np.empty(ends[-1], np.uint8)
        numbers = np.empty(ends[-1], np.int32)
        for layer, of_layer in enumerate(rows):
            part, slots = slice(ends[layer], ends[layer + 1]), self.lanes[lane][layer]
            lattice = self.layout.lattices[layer]
            slots.draw(of_layer, lattice, tuple(array[part] for array in arrays))
            starts[part] = slots.starts[of_layer]
            numbers[part] = of_layer + edges[layer]
        return numbers, Splats(*arrays), starts
