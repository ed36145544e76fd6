"""Files of Gaussians as slots that last: what stays the same from file to file is sent once, and
errors have bounds.

Rule: what a slot holds is known as a player decodes it, and every number is held against the file,
never against what was sent before; so errors do not add up.

Every file is one frame, and the stream has one lane (swin_size 1), so that any Gaussian may change
in any frame: with more lanes a change would wait for its lane's turn, and the frames until then
would be wrong. Slots that nothing happens to cost next to nothing.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace

import numpy as np

from codec.arrays import Bytes, Doubles, Flags, Floats, Longs
from codec.errors import InvalidError
from codec.kernel import kernel
from codec.lattice.forms import MAX_OPACITY_LEVELS, interleave
from codec.lattice.lattice import (
    COLOURS,
    LARGEST,
    TURNS,
    Lattice,
    States,
    lattice_values,
    round_values,
)
from codec.slots.slotlayout import ENDED, KEPT, NEW, PREDICTED, Update
from codec.slots.state import ESCAPED, Slots, empty_arrays, holds
from codec.splats import MAX_SH_DEGREE, Splats, sh_count
from codec.stream.wholeslice import RankFunction, split_counts

from .matching import match

HOLD = 0.75
"""Steps that a value may be off before it is sent again; a new one is rounded, so half a step off.
Above 0.5, so that noise about the middle between two steps is not sent."""

KINDS = ("position", "size", "turn", "colour", "opacity")

COARSER_POSITION, FINER_SIZE, FINER_COLOUR, FINER_OPACITY = 2.1, 3.0, 5.0, 2.0
"""How the errors of a layer differ from those of each Gaussian by itself, at SH degree 3. Found by
drawing: positions change all the time, so each of their bits costs most."""

FLAT = 3.0
"""An axis thinner than the usual size by more than this power of e, 1/20, counts as flat."""

SIZES = 2 * LARGEST + 1
"""Steps between the smallest and the largest log-scale."""

TINY_M = 1e-12

FINEST_OPACITY = HOLD / (MAX_OPACITY_LEVELS - 1)
"""The smallest error of an opacity that a stream can keep."""


@dataclass(frozen=True, slots=True)
class ErrorBound:
    """Largest errors of a Gaussian against the same frame's file. A Gaussian that would exceed one
    is sent at full precision."""

    position: float = 0.067
    """Largest error of each coordinate, as a share of the usual size of a Gaussian: the geometric
    mean of its two larger standard deviations, in the file where that is least."""
    size: float = 0.09
    """Largest error of the natural logarithm of each axis's standard deviation: 0.09 is 9 %. An
    axis thinner than the lattice holds counts as the thinnest that it holds."""
    turn: float = 0.0125
    """Largest error of the components x, y, z of the unit quaternion: 0.0125 is 1.4 degrees."""
    colour: float = 0.042
    """Largest error of Y, Co, Cg of each spherical harmonic coefficient: 0.042 is 0.012 of the
    whole range."""
    opacity: float = 0.02
    """Largest error of the opacity, which lies between 0 and 1."""
    finer: float = 1.0
    """Divisor of all these errors: 2 halves each of them."""

    def __post_init__(self) -> None:
        for field in fields(self):
            value = getattr(self, field.name)
            if not 0 < value < float("inf"):
                raise InvalidError(f"error {field.name} {value:g}: choose more than 0")
        if self.of("opacity") < FINEST_OPACITY * (1 - 1e-9):
            raise InvalidError(
                f"error opacity {self.of('opacity'):g}: choose {FINEST_OPACITY:.4f} or more, "
                "the finest step of a stream"
            )

    def of(self, kind: str) -> float:
        """The bound of one of KINDS."""
        return float(getattr(self, kind)) / self.finer

    def coarser(self, factor: float) -> ErrorBound:
        """These bounds times `factor`, but for the opacity's."""
        return replace(
            self,
            position=self.position * factor,
            size=self.size * factor,
            turn=self.turn * factor,
            colour=self.colour * factor,
        )

    def in_layer(
        self, coarseness: float, sh_degree: int, reach: float, spread: float
    ) -> ErrorBound:
        """The bounds of a layer whose Gaussians show 1 / `coarseness` as much as the usual one, so
        that all kinds of errors show about equally in a picture.

        reach: the largest magnitude of a harmonic coefficient, which one byte must hold; spread: of
        the log-scales, the same.
        """
        size = max(self.size * coarseness / FINER_SIZE, HOLD * spread / SIZES * self.finer)
        # The errors of all coefficients of a colour add up.
        finer = FINER_COLOUR * (sh_count(sh_degree) / sh_count(MAX_SH_DEGREE))
        colour = max(self.colour * coarseness / finer, HOLD * reach / LARGEST * self.finer)
        return replace(
            self,
            position=self.position * coarseness * COARSER_POSITION,
            size=min(size, self.size * max(coarseness, 1)),
            turn=self.turn * coarseness,
            colour=min(colour, self.colour * max(coarseness, 1)),
            opacity=max(self.opacity / FINER_OPACITY, FINEST_OPACITY * self.finer),
        )

    def lattice(self, size_m: float, lowest: float, highest: float) -> Lattice:
        """The lattice that keeps these bounds.

        size_m: the usual size of a Gaussian; lowest, highest: of all log-scales. Raises
        InvalidError for steps that no stream has.
        """
        log_scale = max(self.of("size") / HOLD, spread_of(size_m, lowest, highest) / SIZES)
        base = 0.0
        if highest > LARGEST * log_scale or lowest < -(LARGEST + 1) * log_scale:
            # A large Gaussian must fit; one that is too thin is flat.
            base = (np.ceil(highest / log_scale) - LARGEST) * log_scale
        levels = 1 + int(np.ceil(HOLD / self.of("opacity") - 1e-9))
        return Lattice(
            max(self.of("position") * size_m / HOLD, 1e-6),
            log_scale,
            self.of("turn") / HOLD,
            self.of("colour") / HOLD,
            max(levels, 2),
            base,
        )


def spread_of(size_m: float, lowest: float, highest: float) -> float:
    """The range of log-scales that a lattice must hold, without the thin axes of flat Gaussians;
    see `ErrorBound.lattice`."""
    return highest - max(lowest, float(np.log(max(size_m, TINY_M))) - FLAT)


def steps_of(lattice: Lattice) -> Doubles:
    """(5,) the steps of KINDS, in the units of ErrorBound, but those of positions in metres."""
    steps = lattice.position_m, lattice.log_scale, lattice.rotation, lattice.colour
    return np.array([*steps, 1 / (lattice.opacity_levels - 1)])


def errors_of(values: Doubles, states: States) -> Doubles:
    """(N, 5) how far each of KINDS in `states` is from (N, 3 + A) values of positions and
    attributes, in steps. What is thinner than a lattice holds is flat, and right."""
    errors = np.zeros((len(states), len(KINDS)))
    _errors(values, states.positions, states.attributes, errors)
    return errors


@kernel(nogil=True)
def _errors(values, positions, attributes, errors):  # type: ignore[no-untyped-def]
    """Fills the last, which begins as zeros."""
    last = attributes.shape[1] - 1
    for i in range(values.shape[0]):
        for axis in range(3):
            errors[i, 0] = max(errors[i, 0], abs(values[i, axis] - positions[i, axis]))
        for a in range(last):
            value = values[i, 3 + a]
            kind = 1 + (a >= TURNS) + (a >= COLOURS)
            if kind == 1:
                value = max(value, -128.0)
            errors[i, kind] = max(errors[i, kind], abs(value - np.int8(attributes[i, a])))
        errors[i, 4] = abs(values[i, 3 + last] - attributes[i, last])


SLACK = 1e-6
"""Share of a step that allows for the rounding of the steps themselves."""

BLOCK = 1 << 16
"""Gaussians that become integers at a time."""

CELLS = (1 << 16) - 1
"""Cells along an axis of the curve on which newcomers are ordered."""


@dataclass(frozen=True, slots=True)
class SlotPlan:
    """Facts about all files that are needed before the first one becomes slots."""

    slots: tuple[int, ...]
    """Slots of each layer; their sum is the Gaussian count of the fullest file, or more."""
    shares: tuple[float, ...]
    """Share of a file's Gaussians, by importance, in each layer."""
    sh_degree: int
    lattices: tuple[Lattice, ...]
    """The lattice of each layer."""
    bounds: Doubles  # (L, 5) most that each of KINDS may be off in a layer; of positions in metres
    lower: Doubles  # (3,) metres, of the box along which newcomers are ordered
    upper: Doubles  # (3,)


class SlotFiller:
    """Makes an Update of each file in turn. S is how many slots there are."""

    def __init__(self, plan: SlotPlan, rank: RankFunction) -> None:
        self._plan, self._rank = plan, rank
        self._edges = np.cumsum((0, *plan.slots))
        steps = np.array([steps_of(lattice) for lattice in plan.lattices])
        self._limits = plan.bounds / steps + SLACK  # (L, 5)
        self._holds = np.clip(self._limits.min(axis=1), 0.5, HOLD)
        count = sum(plan.slots)
        self._before = Splats.empty(plan.sh_degree)
        self._slot_of_row: Longs = np.zeros(0, np.int64)  # of _before
        self._states = States.zeros(count, plan.sh_degree)
        self._is_full = np.zeros(count, np.bool_)
        self._has_escaped = np.zeros(count, np.bool_)
        self.errors: Doubles = np.zeros(len(KINDS))
        """The most that each of KINDS was off so far; of positions in metres."""
        self.statuses: Longs = np.zeros(4, np.int64)
        """How many slots were kept, ended, predicted, new so far, after the first file; empty ones
        count as kept."""

    def go_on_after(self, layers: Sequence[Slots]) -> None:
        """Goes on after what a stream's slots hold in each layer: the next file continues it."""
        self._states = States.concatenate([slots.states for slots in layers]).copy()
        conditions = np.concatenate([slots.conditions for slots in layers])
        self._is_full = holds(conditions)
        self._has_escaped = conditions == ESCAPED
        self._slot_of_row = np.flatnonzero(self._is_full)
        parts = []
        for slots, lattice in zip(layers, self._plan.lattices, strict=True):
            rows = np.flatnonzero(holds(slots.conditions))
            arrays = empty_arrays(len(rows), self._plan.sh_degree)
            slots.draw(rows, lattice, arrays)
            parts.append(Splats(*arrays))
        self._before = Splats.concatenate(parts)

    def update(self, birth: int, splats: Splats) -> Update:
        """The update that makes the slots hold `splats`, of the next file, which has at most S
        Gaussians."""
        continued, same = match(self._before, splats)
        lasts = continued >= 0
        slots = np.full(len(splats), -1, np.int64)
        slots[lasts] = self._slot_of_row[continued[lasts]]
        is_free = np.ones(len(self._is_full), np.bool_)
        is_free[slots[lasts]] = False
        statuses = np.full(len(is_free), KEPT, np.uint8)
        statuses[self._is_full & is_free] = ENDED
        self._empty(np.flatnonzero(statuses == ENDED))
        newcomers = np.flatnonzero(~lasts)
        if len(newcomers):
            rows, places = self._placed(splats, newcomers, is_free, slots)
            slots[rows] = places
        changed = np.flatnonzero(lasts & ~same)
        known = ~self._has_escaped[slots[changed]]
        fresh = np.concatenate([newcomers, changed[~known]])
        self._fill(splats, fresh, slots[fresh], None, statuses)
        goes_on = changed[known]
        before = self._states.take(slots[goes_on])
        self._fill(splats, goes_on, slots[goes_on], before, statuses)
        self._before, self._slot_of_row = splats, slots
        if birth:
            self.statuses += np.bincount(statuses, minlength=4)
        return self._update_of(birth, statuses, splats, slots)

    def _empty(self, slots: Longs) -> None:
        self._is_full[slots] = self._has_escaped[slots] = False
        self._states.put(slots, States.zeros(len(slots), self._plan.sh_degree))

    def _fill(
        self, splats: Splats, rows: Longs, slots: Longs, before: States | None, statuses: Bytes
    ) -> None:
        """Puts the Gaussians `rows` into `slots`, which held `before`; fills `statuses`."""
        layers = np.searchsorted(self._edges, slots, side="right") - 1
        for layer in range(len(self._plan.slots)):
            here = np.flatnonzero(layers == layer)
            # Block by block: numbers on the way to integers take eight bytes each.
            for first in range(0, len(here), BLOCK):
                part = here[first : first + BLOCK]
                held = None if before is None else before.take(part)
                self._fill_block(layer, splats, rows[part], slots[part], held, statuses)

    def _fill_block(
        self,
        layer: int,
        splats: Splats,
        rows: Longs,
        slots: Longs,
        before: States | None,
        statuses: Bytes,
    ) -> None:
        states, fits = self._on_lattice(layer, splats.take(rows), before)
        statuses[slots] = NEW
        if before is not None:
            differs = states.differ(before)
            statuses[slots[fits]] = np.where(differs[fits], PREDICTED, KEPT)
        # What has escaped holds no integers that could be predicted from.
        nowhere = np.flatnonzero(~fits)
        states.put(nowhere, States.zeros(len(nowhere), splats.sh_degree))
        self._states.put(slots, states)
        self._is_full[slots] = True
        self._has_escaped[slots] = ~fits

    def _on_lattice(
        self, layer: int, splats: Splats, before: States | None
    ) -> tuple[States, Flags]:
        """`splats`, of `layer`, as integers, and which of them are within the bounds."""
        lattice = self._plan.lattices[layer]
        values = lattice_values(splats, lattice, before)
        states, fits = round_values(values, lattice, before, float(self._holds[layer]))
        errors = errors_of(values, states)
        fits &= (errors <= self._limits[layer]).all(axis=1)
        worst = errors[fits].max(axis=0, initial=0) * steps_of(lattice)
        self.errors = np.maximum(self.errors, worst)
        return states, fits

    def _placed(
        self, splats: Splats, newcomers: Longs, is_free: Flags, slot_of_row: Longs
    ) -> tuple[Longs, Longs]:
        """The rows `newcomers` in some order, and a free slot for each: in the layer that its
        importance among all of `splats` gives it, or the nearest one with room. In a layer they
        follow each other as neighbours do, near the slots of their neighbours among those that
        have one, so that what moves alike stands together and compresses well.

        slot_of_row: of all `splats`, -1 for the newcomers.
        """
        plan = self._plan
        by_rank = np.argsort(-self._rank(splats), kind="stable")
        layers = np.empty(len(splats), np.int64)
        layers[by_rank] = np.repeat(
            np.arange(len(plan.slots)), split_counts(len(splats), plan.shares)
        )
        is_new = np.zeros(len(splats), np.bool_)
        is_new[newcomers] = True
        waiting = by_rank[is_new[by_rank]]  # the most important first
        free = np.flatnonzero(is_free)
        free_of = np.split(free, np.searchsorted(free, self._edges[1:-1]))
        counts = _with_room(
            np.bincount(layers[waiting], minlength=len(plan.slots)),
            np.array([len(slots) for slots in free_of]),
        )
        extent = np.maximum(plan.upper - plan.lower, 1e-9).max()
        cells = np.clip((splats.means[waiting] - plan.lower) / extent, 0, 1) * CELLS
        curve = interleave(cells.astype(np.int64))
        rows, places = [], []
        ends = np.cumsum(counts)
        layer_of_row = np.searchsorted(self._edges, slot_of_row, side="right") - 1
        for layer, (end, count, slots) in enumerate(zip(ends, counts, free_of, strict=True)):
            part = slice(end - count, end)
            there = np.flatnonzero(layer_of_row == layer)
            if not len(there) or not count:
                rows.append(waiting[part][np.argsort(curve[part], kind="stable")])
                places.append(slots[:count])
                continue
            nearest = _nearest_rows(splats.means[there], splats.means[waiting[part]])
            wanted = slot_of_row[there[nearest]]
            order = np.argsort(wanted, kind="stable")
            rows.append(waiting[part][order])
            places.append(slots[_spread(np.searchsorted(slots, wanted[order]), len(slots))])
        return np.concatenate(rows), np.concatenate(places)

    def _update_of(self, birth: int, statuses: Bytes, splats: Splats, slots: Longs) -> Update:
        """The Update of what the slots hold now."""
        coded = np.flatnonzero(statuses >= PREDICTED)
        escaped = self._has_escaped[coded]
        row_of_slot = np.zeros(len(statuses), np.int64)
        row_of_slot[slots] = np.arange(len(slots))
        return Update(
            birth,
            statuses,
            self._states.take(coded),
            np.zeros(len(coded), np.uint8),
            escaped,
            splats.take(row_of_slot[coded[escaped]]),
        )


def _nearest_rows(points_m: Floats, from_m: Floats) -> Longs:
    """(N,) which of `points_m` is nearest to each of `from_m`."""
    from scipy.spatial import cKDTree  # loads slowly, and few commands need it

    # Such a tree is built in a third of the time, for few questions.
    tree = cKDTree(points_m, compact_nodes=False, balanced_tree=False)
    nearest: Longs = tree.query(from_m)[1]
    return nearest


def _spread(wanted: Longs, room: int) -> Longs:
    """(N,) different places below `room`, rising as `wanted` does, each near what is wanted."""
    count = np.arange(len(wanted))
    rising = np.maximum.accumulate(wanted - count) + count
    return np.minimum(rising, room - len(wanted) + count)


def _with_room(wanted: Longs, room: Longs) -> Longs:
    """How many go into each layer: as many as want, but no more than have room; the others go on
    to less important layers, and those that find none there to more important ones."""
    counts = np.zeros_like(wanted)
    waiting = 0
    for layer in range(len(wanted)):
        waiting += wanted[layer]
        counts[layer] = min(waiting, room[layer])
        waiting -= counts[layer]
    for layer in reversed(range(len(wanted))):
        more = min(waiting, room[layer] - counts[layer])
        counts[layer] += more
        waiting -= more
    return counts
