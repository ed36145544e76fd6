"""The Gaussians in training: both generations of every slot, when they show, and every way to
change them but steps.

`Lifespans` is the bookkeeping of the sliding window over slots, slices and generations (paper,
Algorithm 1), in frames. Steps change Gaussians where they live (`Home`). Here they are fetched
before they are read or changed, and what was changed is sent back. A strategy decides what changes
when.

Rule: a matured generation is written by `freeze` alone, so what has left the trainer as a slice
never changes in its later pictures.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from codec.arrays import Flags, Floats, Ints, Longs
from codec.splats import Splats
from trainer.step.backend import Home, Selection
from trainer.step.optimiser import Adam
from trainer.step.raster import Parameters

from .config import FitConfig
from .mcmc import relocate

UPPER_DEAD_OPACITY = 0.03
"""Opacity at or below which a Gaussian is dead, if that is less, in layers above the first that
spare those below them: there faint Gaussians add detail to lower layers, and splitting the few
clear ones of a layer makes all of it faint."""


class Lifespans:
    """Birth, start and expiry of both generations of every slot. Rows as in `Generations`.

    During genesis all Gaussians live in [0, swin_size) and there is no matured generation.
    `stagger` ends genesis; afterwards `mature` hands over one slice a frame.
    """

    def __init__(self, num_gs: int, swin_size: int) -> None:
        self.num_gs = num_gs
        self.swin_size = swin_size
        self.slice_size = num_gs // swin_size
        self.births = np.zeros(num_gs, np.int32)
        self.starts = np.zeros(num_gs, np.int32)
        self.expires = np.full(num_gs, swin_size, np.int32)
        # An empty lifespan: no frame shows a matured generation yet.
        self.matured_starts = np.zeros(num_gs, np.int32)
        self.matured_expires = np.zeros(num_gs, np.int32)

    def stagger(self) -> None:
        """Ends genesis: the lanes live on for one frame more each.

        The slice that expires at e is as if born at e - swin_size, and lies in lane (e - swin_size)
        % swin_size.
        """
        for birth in range(1 - self.swin_size, 1):
            lane = self.lane_rows(birth % self.swin_size)
            self.births[lane] = birth
            self.starts[lane] = birth
            self.expires[lane] = birth + self.swin_size

    def move(self, frames: int) -> None:
        """Makes everything happen so many frames later."""
        for times in (self.births, self.starts, self.expires):
            times += frames
        self.matured_starts += frames
        self.matured_expires += frames

    def deal(self, ranking: Longs) -> Longs:
        """The order that puts the rows in `ranking` into lanes, the first slice into that which
        lives longest, each next one into that which lives a frame less. Row i becomes what row
        order[i] was."""
        order = np.empty(self.num_gs, np.int64)
        for rank in range(self.swin_size):
            lane = self.lane_rows(-rank % self.swin_size)
            order[lane] = ranking[rank * self.slice_size : (rank + 1) * self.slice_size]
        return order

    def lane_rows(self, lane: int) -> slice:
        return slice(lane * self.slice_size, (lane + 1) * self.slice_size)

    def due(self, first_frame: int) -> list[int]:
        """Births of the slices that no frame from `first_frame` on may change, oldest first."""
        return sorted({int(b) for b in self.births[:: self.slice_size] if b < first_frame})

    def mature(self, birth: int) -> slice:
        """Freezes the slice born at `birth` and begins the next generation of its slots.

        Gives the rows of its lane, whose parameters the caller copies to the matured rows, except
        those of kept slots.
        """
        rows = self.lane_rows(birth % self.swin_size)
        trained = ~self.kept(rows)
        self.matured_starts[rows][trained] = self.starts[rows][trained]
        self.matured_expires[rows][trained] = self.expires[rows][trained]
        self.births[rows] = self.expires[rows]
        self.starts[rows] = self.expires[rows]
        self.expires[rows] += self.swin_size
        return rows

    def keep(self, rows: slice) -> None:
        """Leases the slots `rows`, all of one lane whose new generation is not shown yet: what has
        matured in them goes on for another life."""
        self.starts[rows] = self.expires[rows]
        self.matured_expires[rows] = self.expires[rows]

    def take_up(self, rows: Ints) -> None:
        """Ends the leases of `rows`: their new generation shows from its birth on."""
        self.starts[rows] = self.births[rows]
        self.matured_expires[rows] = self.births[rows]

    def kept(self, rows: slice) -> Flags:
        """Which of the slots `rows` are kept: their new generation never shows."""
        kept: Flags = self.starts[rows] == self.expires[rows]
        return kept

    def active_rows(self, frame: int) -> Ints:
        """Rows of both generations that show at `frame`; trainable ones first."""
        current = np.flatnonzero((self.starts <= frame) & (frame < self.expires))
        matured = np.flatnonzero((self.matured_starts <= frame) & (frame < self.matured_expires))
        return np.concatenate([current, matured + self.num_gs]).astype(np.int32)

    def ages(self, first_frame: int) -> Floats:
        """(num_gs,) float32: windows that each row has been trained for before this one."""
        trained = first_frame + self.swin_size - 1 - self.starts
        return np.maximum(trained, 0).astype(np.float32)


class Generations:
    """Parameters, lifespans and Adam's histories of num_gs slots.

    Rows 0..num_gs-1 are the generation being optimised, rows num_gs..2 num_gs-1 the matured
    generation before it in the same slots, which has no history.
    """

    def __init__(self, config: FitConfig, initial: Splats | None) -> None:
        """initial: num_gs Gaussians; None when the arrays of `state` will be filled."""
        self.home = Home()
        """Where they live; the host's arrays until a resident takes them in."""
        self.num_gs = config.num_gs
        self.lifespans = Lifespans(config.num_gs, config.swin_size)
        self._adam = Adam(config.num_gs, config.sh_degree, config.optimiser)
        self._selections: dict[tuple[int, int | None], Selection] = {}
        # A strategy that uses one of these puts its own here.
        self.layers = np.zeros(config.num_gs, np.uint8)
        """The layer of each slot."""
        self.spares_lower_layers = False
        """Whether no Gaussian is relocated onto one of a lower layer."""
        self.follows = np.zeros(config.num_gs, np.bool_)
        """The slots that show what another training has in them: steps and relocation leave them as
        they are."""
        self._values = Parameters.zeros(2 * config.num_gs, config.sh_degree)
        self._values.quats[:, 0] = 1
        self.motions = np.zeros((config.num_gs, 3), np.float32)
        """Metres that each leased slot's Gaussian has moved in its last life; 0 if it was kept or
        is another."""
        if initial is not None:
            self._write(slice(config.num_gs), initial)

    @property
    def values(self) -> Parameters:
        """The parameters as they are now. What changes them has to send them."""
        self.home.fetch()
        return self._values

    @property
    def adam(self) -> Adam:
        """The histories as they are now, with the parameters."""
        self.home.fetch(history=True)
        return self._adam

    def state(self) -> dict[str, npt.NDArray[Any]]:
        """Everything that changes while training. Views, not copies."""
        lifespans, adam = self.lifespans, self.adam
        arrays: dict[str, npt.NDArray[Any]] = {
            "adam_steps": adam.steps,
            "births": lifespans.births,
            "starts": lifespans.starts,
            "expires": lifespans.expires,
            "matured_starts": lifespans.matured_starts,
            "matured_expires": lifespans.matured_expires,
            "motions": self.motions,
        }
        for name, parameters in (
            ("values", self.values),
            ("first", adam.first),
            ("second", adam.second),
        ):
            for i, array in enumerate(parameters.arrays):
                arrays[f"{name}{i}"] = array
        return arrays

    def shown(self, frame: int) -> Splats:
        """A copy of what shows at `frame`."""
        return self.read(self.lifespans.active_rows(frame))

    def selection(self, frame: int, layers: int | None = None) -> Selection:
        """What a step renders that sees `frame`: everything that shows there; of the first `layers`
        layers, if that is given.

        It is kept until `deselect`, so that a resident need not be sent the rows with each step.
        There are at most swin_size frames times the layers of them.
        """
        if (frame, layers) not in self._selections:
            rows = self.lifespans.active_rows(frame)
            if layers is not None:
                rows = rows[self.layers[rows % self.num_gs] < layers]
            trained = rows[rows < self.num_gs]
            trained = trained[~self.follows[trained]]
            self._selections[frame, layers] = Selection(rows, trained)
        return self._selections[frame, layers]

    def deselect(self) -> None:
        """To be called when a lifespan, a layer or what follows another training has changed; each
        window begins with it."""
        self._selections.clear()

    def stagger(self, order: Longs) -> None:
        """Ends genesis: deals the Gaussians out to slices that expire one after another. Row i
        becomes what row order[i] was."""
        self.lifespans.stagger()
        self._move(np.arange(self.num_gs), order)

    def freeze(self, birth: int, splats: Splats, changed: Flags) -> None:
        """Writes the slots of the slice born at `birth` that have `changed` as they have matured:
        those of `splats`, a whole slice."""
        changed_rows = np.flatnonzero(changed)
        self._write(self.matured_rows(birth).start + changed_rows, splats.take(changed_rows))

    def matured_rows(self, birth: int) -> slice:
        """The rows of the slice born at `birth` from its maturing until the next of its lane."""
        rows = self.lifespans.lane_rows(birth % self.lifespans.swin_size)
        return slice(rows.start + self.num_gs, rows.stop + self.num_gs)

    def relocate(
        self, slots: Flags, last_frame: int, dead_opacity: float, rng: np.random.Generator
    ) -> Longs:
        """Moves dead Gaussians of every slice in the window that ends with `last_frame` to living
        ones born no earlier, among `slots` (num_gs,). Gives the rows that moved.

        A dead one keeps its expiry and takes over its target's start, so it may show later than its
        slice is due (the paper's "birth" and "start"). It takes from its target's opacity, which
        a layer needs where it is shown without those above: see `spares_lower_layers`.
        """
        lifespans = self.lifespans
        values, moved, changed = self.values, [np.zeros(0, np.int64)], [np.zeros(0, np.int64)]
        births = np.unique(lifespans.births)
        layers = self.layers if self.spares_lower_layers else np.zeros_like(self.layers)
        for birth in births[births <= last_frame]:
            logits = values.logit_opacities[: self.num_gs]
            least = np.where(layers > 0, min(dead_opacity, UPPER_DEAD_OPACITY), dead_opacity)
            is_dead = logits <= np.log(least / (1 - least))
            shows = (lifespans.starts < lifespans.expires) & slots
            dying = is_dead & shows & (lifespans.births == birth)
            # Slices that no frame of the video shows yet must not attract any.
            begun = (lifespans.births >= birth) & (lifespans.starts <= last_frame)
            living = ~is_dead & shows & begun
            for layer in np.unique(layers[dying]):
                dead = np.flatnonzero(dying & (layers == layer))
                alive = np.flatnonzero(living & (layers >= layer))
                targets = relocate(values, dead, alive, float(least[dead[0]]), rng)
                if len(targets):
                    lifespans.starts[dead] = lifespans.starts[targets]
                    moved.append(dead)
                    changed += [dead, targets]
        rows = np.unique(np.concatenate(changed))
        self._adam.reset(rows)
        self.home.send(rows)
        self.deselect()
        return np.concatenate(moved)

    def least(self, rows: Ints, contributions: Floats, each: int) -> Ints:
        """The `each` of every slice that contribute least among `rows`, which are being optimised,
        slice by slice in turn."""
        least_first = rows[np.argsort(contributions, kind="stable")]
        births = self.lifespans.births[least_first]
        slices = [least_first[births == birth][:each] for birth in np.unique(births)]
        return np.array([row for turn in zip(*slices, strict=True) for row in turn], np.int32)

    def place(self, rows: Ints, splats: Splats, start: int) -> None:
        """Replaces the Gaussians `rows` by `splats`, which show from frame `start` on."""
        self.lifespans.starts[rows] = start
        self._adam.reset(rows)
        self._write(rows, splats)
        self.deselect()

    def show(self, rows: Ints, splats: Splats) -> None:
        """Has the rows `rows` be `splats`, with the histories that they have."""
        self.home.fetch(history=True)  # it is sent along
        self._write(rows, splats)

    def forget(self) -> None:
        """Begins the histories of all Gaussians afresh."""
        self.adam.reset(np.arange(self.num_gs))
        self.home.send(slice(self.num_gs))

    def shift(self, rows: Ints, motions: Floats) -> None:
        """Moves the Gaussians `rows` by `motions` (M, 3), metres."""
        self.home.fetch(history=True)  # it is sent along
        self._values.means[rows] += motions
        self.home.send(rows)

    def trade(self, rows: Ints, others: Ints) -> None:
        """Gaussians in training change places: those of `rows` with those of `others`."""
        self._move(np.concatenate([rows, others]), np.concatenate([others, rows]))

    def _move(self, rows: npt.NDArray[np.integer], origins: npt.NDArray[np.integer]) -> None:
        """Row rows[i] takes over what is trained in row origins[i]."""
        self.adam.move(rows, origins)
        for array in self.values.arrays:
            array[rows] = array[origins]
        self.home.send(rows)

    def read(self, rows: slice | Ints) -> Splats:
        """A copy of the Gaussians `rows`."""
        return Splats(*(array[rows].copy() for array in self.values.arrays))

    def _write(self, rows: slice | npt.NDArray[np.integer], splats: Splats) -> None:
        for array, given in zip(self.values.arrays, splats.arrays, strict=True):
            array[rows] = given
        self.home.send(rows)
