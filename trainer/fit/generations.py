"""The Gaussians in training: both generations of every slot, and how one follows the other.

Steps change them where they live (`Rows`). Here they are fetched before they are read or changed,
and what was changed is sent back.

Rule: a matured generation is written by `mature` alone, so what has left the trainer as a slice
never changes in its later pictures.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from codec.slice import Slice
from codec.slots.update import PREDICTED, Update
from codec.splats import Splats
from trainer.lease.leases import Leases
from trainer.lease.takeover import Crossfade, PlayerState
from trainer.step.backend import Rows
from trainer.step.cpubackend import HostRows
from trainer.step.optimiser import Adam
from trainer.step.raster import Parameters

from .config import FitConfig
from .lifespans import Lifespans
from .mcmc import relocate

Floats = npt.NDArray[np.float32]
Ints = npt.NDArray[np.int32]


class Generations:
    """Parameters, lifespans and Adam's histories of num_gs slots.

    Rows 0..num_gs-1 are the generation being optimised, rows num_gs..2 num_gs-1 the matured
    generation before it in the same slots, which has no history.
    """

    home: Rows
    """Where they live; the host's arrays until a resident takes them in."""

    def __init__(
        self, config: FitConfig, initial: Splats | None, leases: Leases | None = None
    ) -> None:
        """initial: num_gs Gaussians; None when the arrays of `state` will be filled. leases: None
        where every slice is sent whole."""
        self.leases = leases
        self.home = HostRows()
        self.num_gs = config.num_gs
        self.lifespans = Lifespans(config.num_gs, config.swin_size)
        self._adam = Adam(config.num_gs, config.sh_degree, config.optimiser)
        self.takeover: Crossfade | None = None
        """Where slots come to follow another training."""
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
        if self.leases is not None:
            arrays |= self.leases.state()
        return arrays

    def shown(self, frame: int) -> Splats:
        """A copy of what shows at `frame`."""
        return self._read(self.lifespans.active_rows(frame))

    def stagger(self, rng: np.random.Generator) -> None:
        """Ends genesis: deals the Gaussians out to slices that expire one after another."""
        if self.leases is None:
            # At random: slots hand their Gaussians on for the whole video, so slices that are
            # unequal now would stay so, and frames alternate in quality and layers in worth.
            order = self.lifespans.deal(rng.permutation(self.num_gs))
        else:
            order = self.leases.deal(self.values.means[: self.num_gs], rng)
        self.lifespans.stagger()
        self._move(np.arange(self.num_gs), order)

    def mature(self, first_frame: int) -> list[Slice]:
        """Freezes what no frame from `first_frame` on may change, and gives it in the order of
        birth. The next generation of these slots begins with the same parameters."""
        matured = []
        for birth in self.lifespans.due(first_frame):
            rows = self.lifespans.mature(birth)
            frozen = self.matured_rows(birth)
            for array in self.values.arrays:
                array[frozen] = array[rows]
            self.home.send(frozen)
            offsets = self.lifespans.matured_starts[rows] - birth
            matured.append(Slice(birth, self._read(frozen), offsets.astype(np.uint8)))
        return matured

    def mature_leased(self, first_frame: int, leases: Leases) -> list[Update]:
        """The same where slots are leased: what matured goes on with the values that a player has,
        the next generation with its own."""
        updates = []
        for birth in self.lifespans.due(first_frame):
            lane = self.lifespans.lane_rows(birth % self.lifespans.swin_size)
            active = ~self.lifespans.kept(lane)
            went = self.values.means[lane] - self.values.means[self.matured_rows(birth)]
            goes_on = active & ~leases.is_other[lane]
            self.motions[lane] = np.where(goes_on[:, None], went, 0)
            self.lifespans.mature(birth)
            offsets = np.where(active, self.lifespans.matured_starts[lane] - birth, 0)
            theirs = None if self.takeover is None else self.takeover.held(birth)
            other = None
            if self.takeover is not None and theirs is not None:
                follows = self.takeover.follows[lane]
                other, active = (follows, theirs), active & ~follows
            update, exact = leases.mature(birth, lane, active, self._read(lane), offsets, other)
            updates.append(update)
            changed = active if other is None else active | other[0]
            rows = np.flatnonzero(changed) + self.matured_rows(birth).start
            for array, decoded in zip(self.values.arrays, exact.arrays, strict=True):
                array[rows] = decoded[changed]
            self.home.send(rows)
        return updates

    def held(self, update: Update) -> PlayerState:
        """A player's slots of the lane of `update`, which has just matured."""
        offsets = np.zeros(self.lifespans.slice_size, np.uint8)
        offsets[update.statuses >= PREDICTED] = update.start_offsets
        assert self.leases is not None
        lane = self.lifespans.lane_rows(update.birth % self.lifespans.swin_size)
        drawn = self._read(self.matured_rows(update.birth))
        return self.leases.held(update.birth, lane, offsets, drawn)

    def follow(self, birth: int) -> None:
        """Has slots of the slice that is born at `birth` follow another training: they are shown as
        that has them, and not trained."""
        if self.takeover is None:
            return
        lifespans, theirs = self.lifespans, self.takeover.held(birth)
        lane = lifespans.lane_rows(birth % lifespans.swin_size)
        rows = self.takeover.go_on(birth, lane)
        if theirs is None:
            return
        of_lane = rows - lane.start
        lifespans.take_up(rows)
        self.home.fetch(history=True)  # it is sent along
        self._write(rows, theirs.splats.take(of_lane))
        shows = theirs.shows[of_lane]
        lifespans.starts[rows[shows]] += theirs.start_offsets[of_lane][shows]
        lifespans.starts[rows[~shows]] = lifespans.expires[rows[~shows]]

    def matured_rows(self, birth: int) -> slice:
        """The rows of the slice born at `birth` from its maturing until the next of its lane."""
        rows = self.lifespans.lane_rows(birth % self.lifespans.swin_size)
        return slice(rows.start + self.num_gs, rows.stop + self.num_gs)

    def relocate(self, last_frame: int, dead_opacity: float, rng: np.random.Generator) -> None:
        """Moves dead Gaussians of every slice in the window that ends with `last_frame` to living
        ones born no earlier.

        A dead one keeps its expiry and takes over its target's start, so it may show later than its
        slice is due (the paper's "birth" and "start").
        """
        lifespans = self.lifespans
        own = np.ones(self.num_gs, np.bool_) if self.takeover is None else ~self.takeover.follows
        values, changed = self.values, [np.zeros(0, np.int64)]
        births = np.unique(lifespans.births)
        for birth in births[births <= last_frame]:
            logits = values.logit_opacities[: self.num_gs]
            is_dead = logits <= np.log(dead_opacity / (1 - dead_opacity))
            born = (lifespans.births == birth) & (lifespans.starts < lifespans.expires) & own
            dead = np.flatnonzero(is_dead & born)
            # Slices that no frame of the video shows yet must not attract any.
            alive = np.flatnonzero(
                ~is_dead & (lifespans.births >= birth) & (lifespans.starts <= last_frame) & own
            )
            targets = relocate(values, dead, alive, dead_opacity, rng)
            if len(targets):
                lifespans.starts[dead] = lifespans.starts[targets]
                if self.leases is not None:
                    self.leases.is_other[dead] = True
                changed += [dead, np.unique(targets)]
                for rows in changed[-2:]:
                    self._adam.reset(rows)
        self.home.send(np.unique(np.concatenate(changed)))

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
        if self.leases is not None:
            self.leases.is_other[rows] = True

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
        if self.leases is not None:
            self.leases.is_other[rows] = self.leases.is_other[others] = True

    def _move(self, rows: npt.NDArray[np.integer], origins: npt.NDArray[np.integer]) -> None:
        """Row rows[i] takes over what is trained in row origins[i]."""
        self.adam.move(rows, origins)
        for array in self.values.arrays:
            array[rows] = array[origins]
        self.home.send(rows)

    def _read(self, rows: slice | Ints) -> Splats:
        return Splats(*(array[rows].copy() for array in self.values.arrays))

    def _write(self, rows: slice | Ints, splats: Splats) -> None:
        for array, given in zip(self.values.arrays, splats.arrays, strict=True):
            array[rows] = given
        self.home.send(rows)
