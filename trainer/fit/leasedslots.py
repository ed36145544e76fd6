"""The strategy in which most Gaussians last: a slot may keep its Gaussian for another life, with
exactly the values that a player has, and only what changes is trained and sent.

When a window begins, its newest frame says which slots of the newest slice become active: those
that have to do with what changed there, and those that have been kept for longest. Scene flow moves
them to where they went, trades bring what matters into lower layers, and renewal places new
Gaussians. Everything else is kept, and is not trained.

Which values a player has is the matter of trainer/lease.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import numpy.typing as npt

from codec.arrays import Ints
from codec.camera import rotation_of
from codec.foreign.bounds import unit_quats
from codec.slots.slotlayout import KEPT, PREDICTED, SlotLayout, Update
from codec.splats import Splats
from trainer.lease.leases import Leases
from trainer.lease.takeover import Crossfade, PlayerState
from trainer.step.optimiser import cells_of

from .config import WindowPlan
from .observer import Window
from .renew import Comparison
from .sceneflow import scene_flow
from .strategy import Fit, Strategy

LAYERED_FROM = 0.6
"""Share of genesis after which Gaussians have layers, each trained to look right without those
above, if it does not settle: otherwise this begins with the first settling round."""

BASE_PREFIX_RATIO = 1 / 3
"""How often the first k + 1 layers are rendered alone, over the first k, if the first one trains by
itself: so it stays what it was when the others began."""

LEAST_CHANCE = 1e-12
"""The least weight with which a Gaussian is drawn for a cover: some are drawn even if nothing is
wrong."""

COVER_OFFSET = 0.7
"""Standard deviation of a cover's distance from the middle of the Gaussian below, in that one's own
standard deviations. The covers of a Gaussian together are about as large as it: 0.7^2 + 0.6^2."""

COVER_SCALE = 0.6
"""Scales of a cover over those of the Gaussian below."""

COVER_OPACITY = 0.4
"""Opacity of a cover. With 0.22 and with 0.7 the ladder is worse."""

TOGETHER_SIZES = (0.05, 0.02)
"""Sides of the cells in which Gaussians move together, one after the other, over the scene's
extent."""


def covers_of(below: Splats, rng: np.random.Generator) -> Splats:
    """How Gaussians of upper layers begin: a cover of each of the Gaussians `below`, inside it and
    smaller, with its rotation and colour.

    A relocated Gaussian would take from the opacity of its target, which a lower layer needs where
    it is shown alone. A cover leaves the Gaussian below as it is, and learns the detail that is
    missing there. The constants were measured: bench/NOTEBOOK.md.
    """
    log_scales = below.log_scales + np.float32(np.log(COVER_SCALE))
    offsets = COVER_OFFSET * rng.normal(size=below.means.shape) * np.exp(below.log_scales)
    rotations = rotation_of(unit_quats(below.quats).T)  # (3, 3, N)
    means = below.means + np.einsum("ijn,nj->ni", rotations, offsets).astype(np.float32)
    logit = np.float32(np.log(COVER_OPACITY / (1 - COVER_OPACITY)))
    logits = np.full(len(below), logit, np.float32)
    return Splats(means, log_scales, below.quats, logits, below.sh)


class LeasedSlots(Strategy):
    """Leases what stands still. Slots have layers, and updates leave the trainer."""

    def __init__(self, fit: Fit, layout: SlotLayout, takeover: Crossfade | None = None) -> None:
        """takeover: another training that slots come to follow."""
        super().__init__(fit)
        self.leases, self._takeover = Leases(fit.config.lease, layout), takeover
        self._base_rounds = fit.config.base_rounds if len(self.leases.slots) > 1 else 0
        if self._base_rounds:
            self.leases.layers[:] = 0  # until they are ranked
            fit.generations.spares_lower_layers = True
        fit.generations.layers = self.leases.layers
        if takeover is not None:
            fit.generations.follows = takeover.follows

    def state(self) -> dict[str, npt.NDArray[Any]]:
        """What a player has, and since when."""
        return self.leases.state()

    def jump(self, by: int) -> None:
        """Has leases begin later."""
        self.leases.trained += by

    def record_sent_bytes(self, window: Window, num_bytes: int) -> None:
        """Charges the budget, if there is one."""
        if self.leases.budget is not None and window.first_frame:
            sent = sum(int((update.statuses != KEPT).sum()) for update in window.updates)
            self.leases.budget.record_sent_bytes(num_bytes, sent)

    def begin_window(self, plan: WindowPlan) -> WindowPlan:
        """Renews the Gaussians of a settling round, or chooses what a new slice changes."""
        fit, config = self.fit, self.fit.config
        if plan.settled is not None and not plan.begin:
            self._begin_round(plan.settled)
        together: list[Ints] = []
        if plan.brings_new:
            # The window after genesis is the first of all its slices.
            for birth in plan.frames if plan.frames.start == 1 else plan.frames[-1:]:
                self._begin_slice(birth)
            if config.together_share:
                means = fit.generations.values.means[: config.num_gs]
                together = [cells_of(means, size * fit.extent_m) for size in TOGETHER_SIZES]
        if plan.is_genesis:
            return plan
        # Where most slots are kept, what their tiles show reaches no gradient. The loss of a whole
        # picture says more of its camera than of what is still wrong.
        return replace(plan, whole=False, error_share=config.error_share, together=together)

    def _begin_round(self, settled: int) -> None:
        """Renews the Gaussians of a settling round. If the first layer trains by itself, the others
        do not show until they begin anew, as covers of it where it is wrong."""
        fit, layers = self.fit, self.leases.layers
        lifespans = fit.generations.lifespans
        if self._base_rounds and settled == 0:
            self._rank()
            lifespans.starts[layers > 0] = lifespans.expires[layers > 0]
        elif self._base_rounds and settled == self._base_rounds:
            upper, base = np.flatnonzero(layers).astype(np.int32), lifespans.active_rows(0)
            _, _, errors = fit.compare(base, 0, 0)
            chances = np.maximum(errors, LEAST_CHANCE)
            below = fit.rng.choice(base, len(upper), p=chances / chances.sum())
            fit.generations.place(upper, covers_of(fit.generations.read(below), fit.rng), 0)
        fit.renew_genesis()

    def _rank(self) -> None:
        self.leases.rank(self.fit.contributions(self.fit.generations.lifespans.active_rows(0), 0))

    def _begin_slice(self, birth: int) -> None:
        """Leases the slots of the slice that is born at `birth`, a frame that no window saw before,
        and takes up those that change. Those show from then on."""
        fit, leases, generations = self.fit, self.leases, self.fit.generations
        lifespans = generations.lifespans
        lane = lifespans.lane_rows(birth % lifespans.swin_size)
        lifespans.keep(lane)
        self._follow(birth, lane)
        rows = lifespans.active_rows(birth)
        seen, contributions, scores = fit.compare(rows, birth, birth - 1)
        slots = rows % generations.num_gs
        mine = (slots >= lane.start) & (slots < lane.stop) & ~generations.follows[slots]
        active = leases.choose(slots[mine], scores[mine], self._base_rounds > 0)
        if fit.config.scene_flow:
            self._follow_flow(seen, slots, active)
        traded = leases.trades(slots[mine], contributions[mine])
        generations.trade(*traded)
        least = leases.least(slots[mine], contributions[mine], fit.config.mcmc.renew_share)
        least = least[~np.isin(least, traded[0])]  # those matter now
        found = fit.missing(seen, len(least))
        renewed = fit.rng.permutation(least).astype(np.int32)[: len(found)]
        lifespans.take_up(np.unique(np.concatenate([active, *traded, renewed])))
        generations.place(renewed, found, birth)
        leases.is_other[np.concatenate([*traded, renewed])] = True

    def _follow(self, birth: int, lane: slice) -> None:
        """Has slots of `lane` follow the other training: they are shown as that has them, and not
        trained."""
        if self._takeover is None:
            return
        rows, theirs = self._takeover.go_on(birth, lane), self._takeover.held(birth)
        if theirs is None:
            return
        lifespans, of_lane = self.fit.generations.lifespans, rows - lane.start
        lifespans.take_up(rows)
        self.fit.generations.show(rows, theirs.splats.take(of_lane))
        shows = theirs.shows[of_lane]
        lifespans.starts[rows[shows]] += theirs.start_offsets[of_lane][shows]
        lifespans.starts[rows[~shows]] = lifespans.expires[rows[~shows]]

    def _follow_flow(self, seen: Comparison, slots: Ints, active: Ints) -> None:
        """Moves the slots `active` to where the cameras saw them go. slots: those of `seen`."""
        generations = self.fit.generations
        motions = scene_flow(
            seen, generations.values.means[slots], generations.motions[slots], self.fit.rng
        )
        moves = np.isin(slots, active)
        generations.shift(slots[moves], motions[moves])

    def before_step(self, plan: WindowPlan, iteration: int) -> int | None:
        """Has a share of the iterations render a random number of the first layers alone, once
        there are layers."""
        fit, config, begins = self.fit, self.fit.config, self._layered_from(plan)
        if iteration < begins:
            return None
        if plan.is_genesis and not plan.settled and iteration == begins:
            self._rank()
        share = config.settle_prefix_share if plan.is_genesis else config.prefix_share
        if fit.rng.random() >= share:
            return None
        if self._base_rounds:
            chances = BASE_PREFIX_RATIO ** np.arange(len(self.leases.slots) - 1)
        else:  # all but the last layer alone lack little, and learn with the whole
            chances = np.minimum(np.arange(len(self.leases.slots) - 1, 0, -1), 2.0)
        return 1 + int(fit.rng.choice(len(chances), p=chances / chances.sum()))

    def _layered_from(self, plan: WindowPlan) -> int:
        """The iteration from which on layers are trained as such."""
        iterations, settles = plan.schedule.iterations, self.fit.config.settle_rounds
        if len(self.leases.slots) == 1:
            return iterations
        if plan.settled is not None:
            return iterations if plan.settled < self._base_rounds else 0
        if not plan.is_genesis:
            return 0
        return iterations if settles else int(LAYERED_FROM * iterations)

    def after_step(self, plan: WindowPlan, done: int) -> None:
        """Relocates the dead."""
        self.leases.is_other[self.fit.relocate(plan, done)] = True

    def mature(self, frames: range) -> Window:
        """Gives the updates of the slices that mature. Their slots go on with the values that a
        player has, the next generation with its own."""
        generations, lifespans = self.fit.generations, self.fit.generations.lifespans
        if frames.start == 0:
            means = generations.values.means[: generations.num_gs]
            generations.stagger(self.leases.deal(means, self.fit.rng))
        updates = [self._mature(birth) for birth in lifespans.due(frames.start + 1)]
        return Window(frames, updates=tuple(updates))

    def _mature(self, birth: int) -> Update:
        generations, lifespans = self.fit.generations, self.fit.generations.lifespans
        lane = lifespans.lane_rows(birth % lifespans.swin_size)
        active = ~lifespans.kept(lane)
        trained = generations.read(lane)
        went = trained.means - generations.values.means[generations.matured_rows(birth)]
        goes_on = active & ~self.leases.is_other[lane]
        generations.motions[lane] = np.where(goes_on[:, None], went, 0)
        lifespans.mature(birth)
        offsets = np.where(active, lifespans.matured_starts[lane] - birth, 0)
        theirs = None if self._takeover is None else self._takeover.held(birth)
        other, changed = None, active
        if theirs is not None:
            follows = generations.follows[lane]
            other, active, changed = (follows, theirs), active & ~follows, active | follows
        update, exact = self.leases.mature(birth, lane, active, trained, offsets, other)
        generations.freeze(birth, exact, changed)
        return update

    def held(self, window: Window) -> list[PlayerState]:
        """See `Strategy.held`."""
        return [self._held(update) for update in window.updates]

    def _held(self, update: Update) -> PlayerState:
        generations, lifespans = self.fit.generations, self.fit.generations.lifespans
        offsets = np.zeros(lifespans.slice_size, np.uint8)
        offsets[update.statuses >= PREDICTED] = update.start_offsets
        lane = lifespans.lane_rows(update.birth % lifespans.swin_size)
        drawn = generations.read(generations.matured_rows(update.birth))
        return self.leases.held(update.birth, lane, offsets, drawn)
