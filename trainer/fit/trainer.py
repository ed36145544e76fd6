"""Sliding-window training (paper, Algorithm 1): pictures in, one matured slice per frame out.

Nothing here opens a file or prints: the pictures come from a `Pictures`, slices leave through an
iterator, and observers are called on the way.
"""

from __future__ import annotations

import json
from collections import deque
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import numpy.typing as npt

from codec.camera import Camera
from codec.errors import InvalidError
from codec.slots.slotlayout import SlotLayout
from codec.slots.update import KEPT
from codec.splats import Splats
from trainer.lease.leases import Leases
from trainer.lease.takeover import Crossfade, PlayerState
from trainer.pictures.feed import Pictures
from trainer.step.backend import Backend, Selection, Step, Training
from trainer.step.colour import CameraColour
from trainer.step.contribution import summed_contribution
from trainer.step.raster import View
from trainer.step.scalebound import CameraSpread
from trainer.step.together import cells_of

from .cameradraws import CameraDraws
from .config import FitConfig
from .generations import Generations
from .observer import Observer, Progress, Window
from .renew import Comparer, Comparison, missing_splats
from .sceneflow import scene_flow
from .schedule import Schedule, WindowPlan
from .selections import Selections

Doubles = npt.NDArray[np.float64]
Ints = npt.NDArray[np.int32]

FALLBACK_FAR_M = 100.0
"""Depth up to which new things are sought where the rig gives none."""

SMALLEST_HALVED_PX = 64
"""Genesis halves no pictures whose shorter side is below: the windows of SSIM would see little but
the border."""

LAYERED_FROM = 0.6
"""Share of genesis after which Gaussians have layers, each trained to look right without those
above, if it does not settle: otherwise this begins with the first settling round."""

SETTLE_MEANS_LR = 1e-3
"""Learning rate of positions at the start of every settling round, over the scene's extent."""

SETTLE_RENEW_SHARE = 0.1
"""Share of the Gaussians that each settling round renews: those with the least contribution."""

RELOCATE_UNTIL = 0.8
"""Share of a window's iterations after which relocation stops, so that all Gaussians settle.
3DGS-MCMC: 25K of 30K."""

TOGETHER_SIZES = (0.05, 0.02)
"""Sides of the cells in which Gaussians move together, one after the other, over the scene's
extent."""

BOUND_PERIOD = 10
"""Iterations after which scales are brought back within their bound."""
PROGRESS_PERIOD = 20
"""Iterations between two reports of progress."""


def scene_extent_m(cameras: Sequence[Camera]) -> float:
    """1.1 times the largest distance of a camera from the cameras' mean place (3DGS)."""
    positions = np.stack([c.position for c in cameras])
    extent = 1.1 * float(np.linalg.norm(positions - positions.mean(axis=0), axis=1).max())
    return extent if extent > 0 else 1.0


class Trainer:
    """One training run; `windows` does the work."""

    def __init__(
        self,
        config: FitConfig,
        pictures: Pictures,
        initial: Splats | None,
        near_m: float | Sequence[float],
        far_m: float = FALLBACK_FAR_M,
        backend: Backend | None = None,
        observers: Sequence[Observer] = (),
        layout: SlotLayout | None = None,
        search_from_m: float | None = None,
    ) -> None:
        """near_m: nearest depth drawn, for all cameras or for each. initial: num_gs Gaussians to
        begin with; None when `restore` follows. backend: by default the CPU's. layout: where slots
        are leased. search_from_m: least depth at which new places are looked for, by default
        near_m."""
        if initial is not None and (len(initial), initial.sh_degree) != (
            config.num_gs,
            config.sh_degree,
        ):
            raise InvalidError(f"{len(initial)} initial Gaussians for num_gs {config.num_gs}")
        cameras = pictures.cameras
        smallest_px = min(min(c.width_px, c.height_px) for c in cameras)
        if smallest_px < SMALLEST_HALVED_PX:
            config = replace(config, coarse_share=0.0, window_coarse_share=0.0)
        self._config = config
        self._pictures = pictures
        self._observers = observers
        planes_m = [near_m] * len(cameras) if isinstance(near_m, (int, float)) else list(near_m)
        self._views = [View.prepare(*seen) for seen in zip(cameras, planes_m, strict=True)]
        self._half_views = [
            View.prepare(view.camera.halved(), view.near_m)
            for view in self._views
            if config.coarse_share or config.window_coarse_share
        ]
        self._search_m = min(planes_m) if search_from_m is None else search_from_m, far_m
        self._extent_m = scene_extent_m(cameras)
        self._comparer = Comparer(self._views, config.scene_flow)
        # What changes while training; `state` gives all of it.
        self._leases = None if layout is None else Leases(config.lease, layout)
        self._generations = Generations(config, initial, self._leases)
        self._colour = CameraColour(len(cameras), config.colour_lr)
        self._cameras = CameraDraws(len(cameras))
        self._rng = np.random.default_rng(config.seed)
        self._next_window = 0
        self._steps = 0
        self._unread: deque[int | None] = deque()
        training = Training(
            self._generations.values, self._generations.adam, self._colour, pictures, self._views,
            self._half_views, CameraSpread.of(cameras), config.mcmc.dead_opacity,
        )  # fmt: skip
        self._resident = (backend or config.backend("cpu").backend).start(training)
        self._generations.home = self._resident
        self._selections = Selections(self._resident, self._generations)

    @property
    def next_window(self) -> int:
        """First frame of the window to train next."""
        return self._next_window

    def windows(self) -> Iterator[Window]:
        """Trains the rest of the video, window by window."""
        while self._next_window < self._pictures.num_frames:
            first_frame = self._next_window
            for observer in self._observers:
                observer.window_begun(first_frame, 0 if first_frame else self._steps)
            end = min(first_frame + self._config.swin_size, self._pictures.num_frames)
            frames = range(first_frame, end)
            if first_frame == 0:
                self._train_genesis(frames)
            else:
                rate = self._config.optimiser.window_means_lr
                self._train(self._plan(frames, Schedule.window(self._config, rate)))
            self._next_window += 1
            if self._leases is None:
                yield Window(frames, tuple(self._generations.mature(self._next_window)))
            else:
                updates = self._generations.mature_leased(self._next_window, self._leases)
                yield Window(frames, updates=tuple(updates))
            for observer in self._observers:
                observer.window_ended(first_frame)

    def _train_genesis(self, frames: range) -> None:
        """Trains the first window, from the iteration on that a restored state has reached."""
        schedule = Schedule.genesis(self._config)
        self._train(self._plan(frames, schedule), self._steps)
        schedule = Schedule.window(self._config, SETTLE_MEANS_LR)
        for settled in range(self._config.settle_rounds):
            plan = self._plan(frames, schedule, settled)
            if self._steps <= plan.before:
                self._renew(0)
            self._train(plan, self._steps - plan.before)
        self._generations.stagger(self._rng)

    def record_sent_bytes(self, window: Window, num_bytes: int) -> None:
        """Records the bytes that the update of `window`, which `windows` has just given, takes in
        the stream."""
        if self._leases is not None and self._leases.budget is not None and window.first_frame:
            sent = sum(int((update.statuses != KEPT).sum()) for update in window.updates)
            self._leases.budget.record_sent_bytes(num_bytes, sent)

    def contributions(self, window: Window) -> list[Doubles]:
        """For each slice of `window`, which `windows` has just given, (N,) what its Gaussians
        contribute to all training views of the window's frames.

        Gaussians that mature later stand in the way as they are trained so far.
        """
        generations = self._generations
        sums = np.zeros(2 * generations.num_gs, np.float64)
        for frame in window.frames:
            rows = generations.lifespans.active_rows(frame)
            sums[rows] += self._contributions(rows, frame)
        return [sums[generations.matured_rows(part.birth)] for part in window.slices]

    def _contributions(self, rows: Ints, frame: int) -> Doubles:
        """(M,) what the Gaussians `rows`, all that show, contribute to a frame of all views."""
        masks = [self._pictures.mask(c, frame) for c in range(len(self._views))]
        return summed_contribution(self._generations.values, rows, self._views, masks)

    def shown(self, frame: int) -> Splats:
        """The Gaussians that show at `frame`, of the window just trained or to be trained next."""
        return self._generations.shown(frame)

    def num_shown(self, frame: int) -> int:
        """How many Gaussians show at `frame`."""
        return len(self._generations.lifespans.active_rows(frame))

    def state(self) -> dict[str, npt.NDArray[Any]]:
        """Everything that changes while training; `restore` takes it back. Views, not copies.

        Between two windows; and in the first window, because it takes long, when an observer is
        called with its progress.
        """
        random = json.dumps(self._rng.bit_generator.state)
        return {
            **self._generations.state(),
            **self._colour.state(),
            **self._cameras.state(),
            "random": np.frombuffer(random.encode(), np.uint8),
            "counters": np.array([self._next_window, self._steps], np.int64),
        }

    def restore(self, state: Mapping[str, npt.NDArray[Any]]) -> None:
        """Goes back to what `state` gave. Raises InvalidError when it is of another run."""
        mine = self.state()
        for name, array in mine.items():
            if name not in state or (
                name != "random"
                and (state[name].shape, state[name].dtype) != (array.shape, array.dtype)
            ):
                raise InvalidError(f"checkpoint: {name} does not fit these settings")
        for name, array in mine.items():
            if name not in ("random", "counters"):
                array[...] = state[name]
        self._resident.send_all()
        self._rng.bit_generator.state = json.loads(state["random"].tobytes())
        self._next_window, self._steps = (int(n) for n in state["counters"])

    def jump(self, frame: int) -> None:
        """Goes on with the window that begins with `frame`, as if what was trained so far had led
        there. Not before genesis has ended."""
        by = frame - self._next_window
        if not self._next_window or by % self._config.swin_size:
            raise InvalidError(
                f"from frame {self._next_window} to {frame}: jump after genesis, by a multiple of "
                f"swin_size {self._config.swin_size}"
            )
        self._generations.lifespans.move(by)
        if self._leases is not None:
            self._leases.trained += by
        self._next_window = frame

    def take_over(self, takeover: Crossfade | None) -> None:
        """Has slots follow another training from the next window on; None: none from now on."""
        self._generations.takeover = takeover

    def held(self, window: Window) -> list[PlayerState]:
        """A player's slots of the lanes of `window`, which `windows` has just given; slots are
        leased."""
        return [self._generations.held(update) for update in window.updates]

    def _plan(self, frames: range, schedule: Schedule, settled: int | None = None) -> WindowPlan:
        """How a window is trained; gives it its new slices. settled: the rounds that genesis has
        settled for already."""
        config, generations, leases = self._config, self._generations, self._leases
        genesis = frames.start == 0
        before, dead_opacity = 0, config.mcmc.dead_opacity
        if settled is not None:
            before = config.genesis_iterations + settled * config.window_iterations
            dead_opacity = config.mcmc.settle_dead_opacity
        layered_from = schedule.iterations
        if leases is not None and len(leases.slots) > 1:
            if not genesis or settled is not None:
                layered_from = 0
            elif not config.settle_rounds:
                layered_from = int(LAYERED_FROM * schedule.iterations)
        # Neither genesis nor the last windows of a video.
        brings_new = not genesis and len(frames) == config.swin_size
        if brings_new:
            # The window after genesis is the first of all its slices.
            first_is_new = leases is not None and frames.start == 1
            for birth in frames if first_is_new else frames[-1:]:
                self._begin_slice(birth)
        together: list[Ints] = []
        if brings_new and leases is not None and config.together_share:
            means = generations.values.means[: config.num_gs]
            together = [cells_of(means, size * self._extent_m) for size in TOGETHER_SIZES]
        ages = generations.lifespans.ages(frames.start)
        if genesis:
            ages[:] = 0
        # Where most slots are kept, what their tiles show reaches no gradient.
        whole = genesis or leases is None
        return WindowPlan(
            frames=frames,
            schedule=schedule,
            before=before,
            is_ranked=genesis and leases is not None and not settled,
            dead_opacity=dead_opacity,
            layered_from=layered_from,
            prefix_share=config.settle_prefix_share if genesis else config.prefix_share,
            newest_share=config.newest_share if brings_new else 0.0,
            # The loss of a whole picture says more of its camera than of what is still wrong.
            error_share=0.0 if whole else config.error_share,
            whole=whole,
            ages=ages,
            together=together,
            together_share=config.together_share,
        )

    def _train(self, plan: WindowPlan, begin: int = 0) -> None:
        """Optimises the current generation on the frames of a window. begin: iterations of the plan
        that were done before."""
        config, generations, frames = self._config, self._generations, plan.frames
        if frames.start and not config.optimiser.carry_adam:
            generations.forget()
        self._resident.begin_window(plan.ages, plan.together)
        self._selections.forget()
        for iteration in range(begin, plan.schedule.iterations):
            frame = int(self._rng.integers(frames.start, frames.stop))
            if plan.newest_share and self._rng.random() < plan.newest_share:
                frame = frames[-1]
            camera = self._cameras.draw(self._rng, plan.error_share)
            if plan.is_ranked and iteration == plan.layered_from and self._leases is not None:
                rows = generations.lifespans.active_rows(0)
                self._leases.rank(self._contributions(rows, 0))
            has_all = iteration < plan.layered_from or self._rng.random() >= plan.prefix_share
            layers = None if has_all else self._prefix()
            self._step(plan, iteration, camera, frame, self._selections.at(frame, layers))
            # The losses of half pictures are smaller: cameras are compared by those of whole ones.
            is_noted = has_all and not plan.whole and not plan.schedule.is_half(iteration)
            self._unread.append(camera if is_noted else None)
            done = iteration + 1
            if not frames.start and config.mcmc.max_scale and done % BOUND_PERIOD == 0:
                everyone = self._selections.at(frame)
                self._resident.bound_scales(everyone, config.mcmc.max_scale)
            is_due = done % PROGRESS_PERIOD == 0 or done == plan.schedule.iterations
            loss = self._note_losses(is_due)
            relocates = done <= RELOCATE_UNTIL * plan.schedule.iterations
            if relocates and done % config.mcmc.relocate_period == 0:
                generations.relocate(frames[-1], plan.dead_opacity, self._rng)
                self._selections.forget()
            if is_due:
                total = config.iterations(frames.start)
                progress = Progress(frames.start, plan.before + done, total, loss)
                for observer in self._observers:
                    observer.progressed(progress)

    def _note_losses(self, wait: bool) -> float:
        """Takes in the losses that are known by now; with `wait` all. Gives the last of them."""
        last = 0.0
        for last in self._resident.losses(wait):
            camera = self._unread.popleft()
            if camera is not None:
                self._cameras.note(camera, last)
        return last

    def _step(
        self, plan: WindowPlan, iteration: int, camera: int, frame: int, selection: Selection
    ) -> None:
        """One iteration on the Gaussians of `selection`, seen by a camera at a frame."""
        rates = plan.schedule.rates(iteration, self._extent_m)
        step = Step(
            camera, frame, plan.schedule.is_half(iteration), plan.whole, rates.means_lr_m,
            rates.calm, rates.noise_m, self._config.seed * 1_000_003 + self._steps,
            plan.level(iteration),
        )  # fmt: skip
        self._resident.step(step, selection)
        self._steps += 1

    def _prefix(self) -> int:
        """A random number of the first layers, which a step renders alone."""
        leases = self._leases
        assert leases is not None
        # All but the last layer alone lack little, and learn with the whole.
        chances = np.minimum(np.arange(len(leases.slots) - 1, 0, -1), 2)
        return 1 + int(self._rng.choice(len(chances), p=chances / chances.sum()))

    def _renew(self, frame: int) -> None:
        """Replaces the Gaussians of genesis that contribute least, where `frame` shows what is not
        rendered."""
        generations = self._generations
        rows = generations.lifespans.active_rows(frame)
        seen, contributions, _ = self._comparer.compare(
            generations.values, rows, self._pictures, frame, self._colour
        )
        each = round(SETTLE_RENEW_SHARE * len(rows))
        least = generations.least(rows, contributions, each)
        found = missing_splats(seen, len(least), *self._search_m, self._config.sh_degree, self._rng)
        generations.place(least[: len(found)], found, frame)

    def _begin_slice(self, frame: int) -> None:
        """Prepares the slice that is born in `frame`, which no window saw before: leases
        what stands still, and places the least contributing Gaussians of every slice where the
        frame shows what is not rendered. Those show from then on."""
        config, generations, leases = self._config, self._generations, self._leases
        lifespans = generations.lifespans
        lane = lifespans.lane_rows(frame % lifespans.swin_size)
        if leases is not None:
            lifespans.keep(lane)
            generations.follow(frame)
        elif config.mcmc.renew_share == 0:
            return
        # Without leases, whatever has matured before this window expires before its last frame.
        rows = lifespans.active_rows(frame)
        before = None if leases is None else frame - 1
        seen, contributions, scores = self._comparer.compare(
            generations.values, rows, self._pictures, frame, self._colour, before
        )
        if leases is None:
            each = round(config.mcmc.renew_share * lifespans.slice_size)
            least = generations.least(rows, contributions, each)
        else:
            slots = rows % config.num_gs
            mine = (slots >= lane.start) & (slots < lane.stop)
            if generations.takeover is not None:
                mine &= ~generations.takeover.follows[slots]
            active = leases.choose(slots[mine], scores[mine])
            if config.scene_flow:
                self._follow_flow(seen, rows, active)
            traded = leases.trades(slots[mine], contributions[mine])
            generations.trade(*traded)
            least = leases.least(slots[mine], contributions[mine], config.mcmc.renew_share)
            least = least[~np.isin(least, traded[0])]  # those matter now
        found = missing_splats(seen, len(least), *self._search_m, config.sh_degree, self._rng)
        if leases is not None:
            least = self._rng.permutation(least).astype(np.int32)
            lifespans.take_up(np.unique(np.concatenate([active, *traded, least[: len(found)]])))
        generations.place(least[: len(found)], found, frame)

    def _follow_flow(self, seen: Comparison, rows: Ints, active: Ints) -> None:
        """Moves the slots `active` to where the cameras saw them go. rows: those of `seen`."""
        generations, num_gs = self._generations, self._config.num_gs
        slots = rows % num_gs
        motions = scene_flow(
            seen, generations.values.means[slots], generations.motions[slots], self._rng
        )
        moves = np.isin(slots, active)
        generations.shift(slots[moves], motions[moves])
