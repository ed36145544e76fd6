"""The interface of an edit, and the slices of its source in turn, decoded and as they lie in its
files.

Rule: an edit says what a slot holds afterwards. Whether that is kept, predicted or new follows from
what the edited stream held there before, so an edit cannot make a stream that does not hold
together.

Turned axes call for another order of the slots, because a position is coded as the difference to
that of the new Gaussian before it. Which slot of its layer a new Gaussian gets is free, and nobody
sees it.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from codec.arrays import Bytes, Doubles, Flags, Longs
from codec.errors import InvalidError
from codec.lattice.lattice import Lattice, States, dequantise
from codec.slice import window_births
from codec.slots.decoder import SlotDecoder
from codec.slots.skipmap import decode_skip_map
from codec.slots.slotlayout import ENDED, KEPT, NEW, PREDICTED, SlotLayout, Update
from codec.slots.state import ESCAPED, ON_LATTICE, Slots, holds
from codec.splats import Splats
from codec.stream.integrity import CheckedObject
from codec.stream.manifest import SKIP_MAPS, Manifest, Part
from codec.stream.reader import StreamReader, roll
from codec.stream.views import view_from_text
from codec.stream.wholeslice import neighbours_first

HOLD = 0.75
"""Steps that a number which is put on the lattice again may be off before it is sent again: above
0.5, so that rounding twice costs no bytes."""


@dataclass(frozen=True, slots=True)
class Turn:
    """One layer of a lane just after a slice."""

    frame: int
    """Birth of the slice; below 0 for what shows in frame 0 already."""
    lane: int
    layer: int
    lattice: Lattice
    statuses: Bytes  # (S,) what the slice says; in a window's first frame new for all that is held
    slots: Slots  # (S) what the slots hold now; not to be altered

    def means(self) -> Doubles:
        """(S, 3) centres in metres as players decode them; empty slots lie at 0."""
        step = np.float32(self.lattice.position_m)
        means = (self.slots.states.positions.astype(np.float32) * step).astype(np.float64)
        means[self.slots.escape_rows] = self.slots.escapes.means
        return means


class Edit:
    """One edit. This one changes nothing; each kind of edit overrides what it alters."""

    rounds = False
    """Whether `states` may give the same integers for Gaussians that differ."""

    rearranges = False
    """Whether new Gaussians are assigned to slots again, because the edit changes their order in
    space."""

    def coarser(self, factor: float) -> Edit:
        """This edit with `factor` times the steps in all that it rounds."""
        return self

    def manifest(self, source: Manifest) -> Manifest:
        """The manifest of the edited stream."""
        return source

    def keeps(self, turn: Turn) -> Flags:
        """(S,) which slots hold something that stays; what it says of empty slots does not
        count."""
        return np.ones(len(turn.slots), np.bool_)

    def states(self, layer: int, states: States, before: States | None) -> tuple[States, Flags]:
        """`states` of `layer` on the lattice of the edited stream, and (N,) which fit there.

        before: what the edited stream holds of the same Gaussians so far; None for new ones.
        """
        return states, np.ones(len(states), np.bool_)

    def check(self) -> None:
        """Called when all frames are through, before the result appears. Raises InvalidError if it
        makes no sense."""

    def splats(self, splats: Splats) -> Splats:
        """Gaussians that escape the lattice, edited."""
        return splats


class Arrangement:
    """Follows which slot of the source each slot of the edited stream stands for."""

    def __init__(self) -> None:
        self._sources: dict[tuple[int, int], Longs] = {}
        """(S,) slots of the source for each lane and layer."""

    def arranged(self, turn: Turn, edit: Edit) -> Turn:
        """`turn`, of the next slice of its lane, with the slots of the edited stream.

        New Gaussians are ordered anew, by their places after `edit`, where they are most of what
        the slots hold; else they would leave the neighbours beside whose slots they were put.
        """
        slots = turn.slots
        sources = self._sources.setdefault((turn.lane, turn.layer), np.arange(len(slots)))
        is_new = turn.statuses == NEW
        if 2 * np.count_nonzero(is_new) > np.count_nonzero(holds(slots.conditions)):
            places = np.flatnonzero(is_new[sources])
            rows = sources[places]
            states, fits = edit.states(turn.layer, slots.states.take(rows), None)
            sources[places] = rows[neighbours_first(states, fits)]
        return replace(turn, statuses=turn.statuses[sources], slots=slots.rearranged(sources))


def derive(
    birth: int, turns: Sequence[Turn], held: Sequence[Slots], edit: Edit, joins: bool = False
) -> Update:
    """The update born at `birth`, of all layers of a lane that holds `held` in the edited stream,
    and should hold what `turns` hold in the source after `edit`.

    joins: whether `held` may be of another stream, so that Gaussians that are near are the same.
    """
    parts = [_Part(turn, slots, edit, joins) for turn, slots in zip(turns, held, strict=True)]
    return Update(
        birth,
        np.concatenate([part.statuses for part in parts]),
        States.concatenate([part.states for part in parts]),
        np.concatenate([part.start_offsets for part in parts]),
        np.concatenate([part.escaped for part in parts]),
        Splats.concatenate([part.escapes for part in parts]),
    )


NEAR, NEAR_STEPS = 32, 3.0
"""Steps, of a coordinate and in the mean of the attributes, within which a Gaussian of a stream is
taken for the one that the stream before it held in the same slot: what was cut is joined again."""


class _Part:
    """One layer of the update."""

    def __init__(self, turn: Turn, held: Slots, edit: Edit, joins: bool) -> None:
        slots, said = turn.slots, turn.statuses
        wanted = holds(slots.conditions) & edit.keeps(turn)
        had = holds(held.conditions)
        # Unless a Gaussian is new, its slot in the edited stream holds it already, or nothing.
        goes_on = wanted & had & (said != NEW)
        moves = np.flatnonzero(goes_on & (said == PREDICTED) & (held.conditions == ON_LATTICE))
        fresh = np.flatnonzero(wanted & ~(goes_on & (said == KEPT)))
        fresh = np.setdiff1d(fresh, moves, assume_unique=True)
        self.statuses: Bytes = np.full(len(slots), KEPT, np.uint8)
        self.statuses[~wanted & (had | (said == ENDED))] = ENDED
        self.statuses[moves], self.statuses[fresh] = PREDICTED, NEW

        states = States.zeros(len(slots), slots.states.sh_degree)
        escaped = np.zeros(len(slots), np.bool_)
        before = held.states.take(moves)
        moved, fits = edit.states(turn.layer, slots.states.take(moves), before)
        states.put(moves, moved)
        self._escape(moves[~fits], escaped)
        if edit.rounds:
            self.statuses[moves[fits & ~moved.differ(before)]] = KEPT
        inside = fresh[slots.conditions[fresh] == ON_LATTICE]
        self._escape(fresh[slots.conditions[fresh] == ESCAPED], escaped)
        brought, fits = edit.states(turn.layer, slots.states.take(inside), None)
        states.put(inside, brought)
        self._escape(inside[~fits], escaped)
        starts = np.where(said == NEW, slots.starts, 0).astype(np.uint8)
        if joins:
            known = (held.conditions == ON_LATTICE) & (self.statuses == NEW) & ~escaped
            off = np.abs(states.numbers() - held.states.numbers())
            known &= (starts == 0) & (off[:, :3].max(axis=1) <= NEAR)
            known &= off[:, 3:].mean(axis=1) <= NEAR_STEPS
            self.statuses[known] = np.where(off[known].any(axis=1), PREDICTED, KEPT)

        coded = np.flatnonzero(self.statuses >= PREDICTED)
        self.states = states.take(coded)
        self.start_offsets = np.where(self.statuses == NEW, starts, 0).astype(np.uint8)[coded]
        self.escaped = escaped[coded]
        self.escapes = edit.splats(_floats(turn, coded[self.escaped]))

    def _escape(self, rows: Longs, escaped: np.ndarray) -> None:
        self.statuses[rows] = NEW
        escaped[rows] = True


def _floats(turn: Turn, rows: Longs) -> Splats:
    """The Gaussians in the slots `rows` of the source, as players decode them."""
    slots = turn.slots
    splats = dequantise(slots.states.take(rows), turn.lattice)
    place_of = np.full(len(slots), -1, np.int64)
    place_of[slots.escape_rows] = np.arange(len(slots.escape_rows))
    places = place_of[rows]
    for array, source in zip(splats.arrays, slots.escapes.arrays, strict=True):
        array[places >= 0] = source[places[places >= 0]]
    return splats


@dataclass(frozen=True, slots=True)
class SourceSlice:
    """A slice, and what its lane holds after it."""

    birth: int
    statuses: Bytes  # (S,)
    lane: list[Slots]
    """Layer after layer; not to be altered, and valid until the next slice."""

    def turns(self, layout: SlotLayout) -> Iterator[Turn]:
        """The slice, layer after layer."""
        lane = layout.lane(self.birth)
        for layer, slots in enumerate(self.lane):
            statuses = self.statuses[layout.row_edges[layer] : layout.row_edges[layer + 1]]
            yield Turn(self.birth, lane, layer, layout.lattices[layer], statuses, slots)


class Walk:
    """Goes through a stream slice by slice; holds the objects of one segment, and what the slots
    hold."""

    def __init__(self, reader: StreamReader) -> None:
        self.reader = reader
        self._objects: dict[Part, CheckedObject] = {}
        self._segment = -1
        self._decoder = SlotDecoder(reader.manifest.slot_layout)

    def opening(self, frame: int) -> Iterator[SourceSlice]:
        """The slices that show at `frame`, oldest first, as if what they show were new in them."""
        self._seek(frame)
        for birth in window_births(frame, self._decoder.layout.swin_size):
            yield self._whole(birth)

    def slices(self, births: range) -> Iterator[SourceSlice]:
        """The slices of `births`, which begin behind frame 0."""
        if births and self._decoder.frame != births[0] - 1:
            self._seek(births[0] - 1)
        for birth in births:
            yield self._next(birth)

    def replacing(self, births: range) -> Iterator[SourceSlice]:
        """The slices of `births`, from 0 on, which bring what the stream shows to lanes that hold
        something else: what each lane shows in its first turn is new."""
        self._seek(0)
        for birth in births:
            found = self._next(birth) if birth else self._whole(0)
            yield found if birth >= len(self._decoder.lanes) else self._whole(birth)

    def decoder(self, frame: int) -> SlotDecoder:
        """The state of a reader at `frame`; not to be altered, and valid until the walk goes on."""
        if self._decoder.frame != frame:
            self._seek(frame)
        return self._decoder

    def content(self, birth: int, part: Part) -> tuple[bytes, bytes]:
        """The chunk of `part` in the slice of `birth`, and its packet as it is; none of both if it
        has none."""
        found = self._object(self.reader.manifest.segment_of(birth), part)
        return found.content(birth), found.packet(birth)

    def _seek(self, frame: int) -> None:
        if not 0 <= frame < self.reader.num_frames:
            raise InvalidError(f"{self.reader.name} has no frame {frame}")
        self._decoder = self.reader.decoder_at(frame, self.reader.manifest.num_layers)

    def _next(self, birth: int) -> SourceSlice:
        decoder, manifest = self._decoder, self.reader.manifest
        layout, history = decoder.layout, decoder.history.of(birth).copy()
        roll(self._object, manifest, birth, decoder)
        skip_map = self._object(manifest.segment_of(birth), SKIP_MAPS).content(birth)
        statuses = decode_skip_map(layout, birth, skip_map, history)
        return SourceSlice(birth, statuses, decoder.lanes[layout.lane(birth)])

    def _whole(self, birth: int) -> SourceSlice:
        """All that the lane of `birth` holds, as new."""
        lane = self._decoder.lanes[self._decoder.layout.lane(birth)]
        held = np.concatenate([holds(slots.conditions) for slots in lane])
        return SourceSlice(birth, np.where(held, NEW, KEPT).astype(np.uint8), lane)

    def _object(self, segment: int, part: Part) -> CheckedObject:
        if segment != self._segment:
            self._objects, self._segment = {}, segment
        if part not in self._objects:
            self._objects[part] = self.reader.read_object(segment, part)
        return self._objects[part]


@dataclass(frozen=True, slots=True)
class ViewOptions:
    """A new first view, a new title, or both."""

    view: str | None = None
    """The view to open with, as the link button of the browser player writes it: what stands behind
    view= in the link. Write --view=-1.1,0.2,1,0,0 if it begins with a minus."""
    camera: str | None = None
    """The camera of the stream to open with."""
    title: str | None = None
    """The new title."""


class View(Edit):
    """Changes the manifest alone, so that segments are copied byte for byte."""

    def __init__(self, options: ViewOptions) -> None:
        """Raises InvalidError for options that do not go together."""
        if options.view is not None and options.camera is not None:
            raise InvalidError("--view cannot be combined with --camera")
        if options.view is None and options.camera is None and options.title is None:
            raise InvalidError("nothing to change; give --view, --camera or --title")
        self._options = options

    def manifest(self, source: Manifest) -> Manifest:
        options = self._options
        if options.title is not None:
            source = replace(source, title=options.title)
        if options.camera is not None:
            name = source.camera(options.camera).name
            return replace(source, default_camera=name, view=None)
        if options.view is not None:
            view = view_from_text(options.view, source)
            return replace(source, view=replace(view, name="view"))
        return source
