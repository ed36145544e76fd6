"""What becomes of the Gaussians besides their steps: which of them are dealt to which slice, are
relocated or renewed, and leave the trainer.

A strategy is told when a window begins, before and after each of its iterations, and when slices
mature. There it composes steps: relocation and renewal, which a `Fit` has, and its own. It draws
random numbers only from `Fit.rng` and gives all that it keeps in `state`, so that a resumed run
writes the same bytes. This file has the strategy of the paper, leasedslots.py the one in which most
Gaussians last.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from codec.arrays import Doubles, Floats, Ints, Longs
from codec.errors import InvalidError
from codec.slice import Slice
from codec.splats import Splats
from trainer.lease.takeover import PlayerState
from trainer.pictures.framecache import Pictures
from trainer.step.contribution import summed_contribution
from trainer.step.raster import View

from .config import FitConfig, WindowPlan
from .generations import Generations
from .observer import Window
from .renew import Comparer, Comparison, missing_splats

SETTLE_RENEW_SHARE = 0.1
"""Share of the Gaussians that each settling round renews: those with the least contribution."""

RELOCATE_UNTIL = 0.8
"""Share of a window's iterations after which relocation stops, so that all Gaussians settle.
3DGS-MCMC: 25K of 30K."""


@dataclass(frozen=True, slots=True)
class Fit:
    """A training as its strategy sees it, with the steps that strategies have in common."""

    config: FitConfig
    generations: Generations
    pictures: Pictures
    views: Sequence[View]
    """One for each camera."""
    comparer: Comparer
    search_m: tuple[float, float]
    """Depths between which new places are looked for."""
    extent_m: float
    """Of the scene."""
    rng: np.random.Generator

    def contributions(self, rows: Ints, frame: int) -> Doubles:
        """(M,) what the Gaussians `rows`, all that show, contribute to a frame of all views."""
        masks = [self.pictures.mask(c, frame) for c in range(len(self.views))]
        return summed_contribution(self.generations.values, rows, self.views, masks)

    def compare(
        self, rows: Ints, frame: int, before: int | None = None
    ) -> tuple[Comparison, Floats, Doubles]:
        """See `Comparer.compare`."""
        return self.comparer.compare(self.generations.values, rows, frame, before)

    def missing(self, seen: Comparison, count: int) -> Splats:
        """At most `count` Gaussians, in random order, where `seen` shows what is not rendered."""
        return missing_splats(seen, count, *self.search_m, self.config.sh_degree, self.rng)

    def renew(self, frame: int, each: int) -> None:
        """Renewal: replaces, of every slice, the `each` Gaussians that contribute least to `frame`,
        by such as show from then on what is not rendered there."""
        rows = self.generations.lifespans.active_rows(frame)
        seen, contributions, _ = self.compare(rows, frame)
        least = self.generations.least(rows, contributions, each)
        found = self.missing(seen, len(least))
        self.generations.place(least[: len(found)], found, frame)

    def renew_genesis(self) -> None:
        """Renews what a settling round begins with."""
        self.renew(0, round(SETTLE_RENEW_SHARE * self.config.num_gs))

    def relocate(self, plan: WindowPlan, done: int) -> Longs:
        """Relocation, after the iterations of `plan` that call for it: moves dead Gaussians to
        living ones, see `Generations.relocate`. Gives the rows that moved."""
        mcmc, generations = self.config.mcmc, self.generations
        if done % mcmc.relocate_period or done > RELOCATE_UNTIL * plan.schedule.iterations:
            return np.zeros(0, np.int64)
        dead_opacity = mcmc.dead_opacity if plan.settled is None else mcmc.settle_dead_opacity
        return generations.relocate(~generations.follows, plan.frames[-1], dead_opacity, self.rng)


class Strategy:
    """Told of a training as it goes on. Subclasses override what they need; `mature` they must."""

    def __init__(self, fit: Fit) -> None:
        self.fit = fit

    def begin_window(self, plan: WindowPlan) -> WindowPlan:
        """A window, or a round of settling, is about to be trained: places Gaussians, and gives the
        plan to train by."""
        return plan

    def before_step(self, plan: WindowPlan, iteration: int) -> int | None:
        """The first layers that an iteration renders alone; None if it renders everything."""
        return None

    def after_step(self, plan: WindowPlan, done: int) -> None:
        """So many iterations of the plan are done."""

    def mature(self, frames: range) -> Window:
        """The window of `frames` is trained: freezes the slices that no later one may change, and
        gives them. After genesis it first deals the Gaussians out (`Generations.stagger`)."""
        raise NotImplementedError

    def state(self) -> dict[str, npt.NDArray[Any]]:
        """All that it changes while training, outside its `fit`. Views, not copies: a state is
        restored by writing to them."""
        return {}

    def record_sent_bytes(self, window: Window, num_bytes: int) -> None:
        """Is told how many bytes the updates of `window`, the last one, take in the stream."""

    def jump(self, by: int) -> None:
        """Goes on as if everything had happened `by` frames later."""

    def held(self, window: Window) -> list[PlayerState]:
        """A player's slots of the lanes of `window`, the last one. Raises InvalidError where no
        slot lasts."""
        raise InvalidError(f"{type(self).__name__} keeps nothing of what a player has")


class WholeSlices(Strategy):
    """The paper's: one slice of new Gaussians matures with each frame, and is sent whole."""

    def begin_window(self, plan: WindowPlan) -> WindowPlan:
        """Renews the Gaussians of a settling round, and a share of every slice where a new frame
        shows what is not rendered."""
        # Whatever has matured before this window expires before its newest frame.
        share = self.fit.config.mcmc.renew_share
        if plan.settled is not None and not plan.begin:
            self.fit.renew_genesis()
        elif plan.brings_new and share:
            lifespans = self.fit.generations.lifespans
            self.fit.renew(plan.frames[-1], round(share * lifespans.slice_size))
        return plan

    def after_step(self, plan: WindowPlan, done: int) -> None:
        """Relocates the dead."""
        self.fit.relocate(plan, done)

    def mature(self, frames: range) -> Window:
        """Freezes whole slices. The next generation of their slots begins with the same
        parameters."""
        generations, lifespans = self.fit.generations, self.fit.generations.lifespans
        if frames.start == 0:
            # At random: slots hand their Gaussians on for the whole video, so slices that are
            # unequal now would stay so, and frames alternate in quality and layers in worth.
            generations.stagger(lifespans.deal(self.fit.rng.permutation(generations.num_gs)))
        slices = []
        for birth in lifespans.due(frames.start + 1):
            lane = lifespans.mature(birth)
            splats = generations.read(lane)
            generations.freeze(birth, splats, np.ones(len(splats), np.bool_))
            offsets = lifespans.matured_starts[lane] - birth
            slices.append(Slice(birth, splats, offsets.astype(np.uint8)))
        return Window(frames, tuple(slices))
