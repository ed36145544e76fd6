"""Sliding-window training (paper, Algorithm 1): pictures in, one matured slice per frame out.

Nothing here opens a file or prints: the pictures come from a `Pictures`, slices leave through an
iterator, and observers are called on the way. What becomes of the Gaussians besides their steps is
decided by a `Strategy`.
"""

from __future__ import annotations

import json
from collections import deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import numpy.typing as npt

from codec.arrays import Doubles
from codec.camera import Camera
from codec.errors import InvalidError
from codec.splats import Splats
from trainer.pictures.framecache import Pictures
from trainer.step.backend import Backend, Selection, Step, Training
from trainer.step.colour import CameraColour
from trainer.step.optimiser import CameraSpread
from trainer.step.raster import View

from .config import FitConfig, Schedule, WindowPlan
from .generations import Generations
from .observer import Observer, Progress, Window
from .renew import Comparer
from .strategy import Fit, Strategy, WholeSlices

FALLBACK_FAR_M = 100.0
"""Depth up to which new things are sought where the rig gives none."""

SMALLEST_HALVED_PX = 64
"""Genesis halves no pictures whose shorter side is below: the windows of SSIM would see little but
the border."""

SETTLE_MEANS_LR = 1e-3
"""Learning rate of positions at the start of every settling round, over the scene's extent."""

BOUND_PERIOD = 10
"""Iterations after which scales are brought back within their bound."""
PROGRESS_PERIOD = 20
"""Iterations between two reports of progress."""


def scene_extent_m(cameras: Sequence[Camera]) -> float:
    """1.1 times the largest distance of a camera from the cameras' mean place (3DGS)."""
    positions = np.stack([c.position for c in cameras])
    extent = 1.1 * float(np.linalg.norm(positions - positions.mean(axis=0), axis=1).max())
    return extent if extent > 0 else 1.0


class CameraDraws:
    """Draws cameras by their errors, so that none falls behind its share for long.

    Every draw adds its share to what each camera is owed; one of those that are owed most is drawn
    and pays 1. So it is a shuffle of all cameras while they are equally wrong.
    """

    def __init__(self, num_cameras: int) -> None:
        self._owed = np.zeros(num_cameras)
        self._losses = np.zeros(num_cameras)

    def state(self) -> dict[str, npt.NDArray[Any]]:
        """The values that training changes. Views, not copies."""
        return {"cameras_owed": self._owed, "cameras_losses": self._losses}

    def shares(self, error_share: float) -> Doubles:
        """(C,) how often each camera is drawn, as a share of all draws. error_share: of them, those
        that go by errors; the rest is for all alike."""
        count = len(self._losses)
        even = np.full(count, 1 / count)
        seen = self._losses > 0
        if not seen.any():
            return even
        # A camera that was not drawn yet counts with the mean error of the others.
        losses = np.where(seen, self._losses, self._losses[seen].mean())
        shares: Doubles = losses / losses.sum()
        return (1 - error_share) * even + error_share * shares

    def draw(self, rng: np.random.Generator, error_share: float) -> int:
        """The camera of the next iteration; error_share as in `shares`."""
        self._owed += self.shares(error_share)
        most = np.flatnonzero(self._owed > self._owed.max() - 0.5)
        camera = int(rng.choice(most))
        self._owed[camera] -= 1
        return camera

    def note(self, camera: int, loss: float) -> None:
        """Takes in the loss of an iteration that looked through `camera`."""
        self._losses[camera] = loss


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
        strategy: Callable[[Fit], Strategy] = WholeSlices,
        search_from_m: float | None = None,
    ) -> None:
        """near_m: nearest depth drawn, for all cameras or for each. initial: num_gs Gaussians to
        begin with; None when `restore` follows. backend: by default the CPU's. strategy: makes that
        of this training. search_from_m: least depth at which new places are looked for, by default
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
        search_from_m = min(planes_m) if search_from_m is None else search_from_m
        # What changes while training; `state` gives all of it.
        self._generations = Generations(config, initial)
        self._colour = CameraColour(len(cameras), config.colour_lr)
        self._cameras = CameraDraws(len(cameras))
        self._rng = np.random.default_rng(config.seed)
        self._next_window = 0
        self._steps = 0
        self._unread: deque[int | None] = deque()
        self._fit = Fit(
            config, self._generations, pictures, self._views,
            Comparer(self._views, pictures, self._colour, config.scene_flow),
            (search_from_m, far_m), scene_extent_m(cameras), self._rng,
        )  # fmt: skip
        self.strategy = strategy(self._fit)
        training = Training(
            self._generations.values, self._generations.adam, self._colour, pictures, self._views,
            self._half_views, CameraSpread.of(cameras), config.mcmc.dead_opacity,
        )  # fmt: skip
        self._resident = (backend or config.backend("cpu").backend).start(training)
        self._generations.home = self._resident

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
            yield self.strategy.mature(frames)
            for observer in self._observers:
                observer.window_ended(first_frame)

    def _train_genesis(self, frames: range) -> None:
        """Trains the first window, from the iteration on that a restored state has reached."""
        self._train(self._plan(frames, Schedule.genesis(self._config)))
        schedule = Schedule.window(self._config, SETTLE_MEANS_LR)
        for settled in range(self._config.settle_rounds):
            self._train(self._plan(frames, schedule, settled))

    def contributions(self, window: Window) -> list[Doubles]:
        """For each slice of `window`, which `windows` has just given, (N,) what its Gaussians
        contribute to all training views of the window's frames.

        Gaussians that mature later stand in the way as they are trained so far.
        """
        generations = self._generations
        sums = np.zeros(2 * generations.num_gs, np.float64)
        for frame in window.frames:
            rows = generations.lifespans.active_rows(frame)
            sums[rows] += self._fit.contributions(rows, frame)
        return [sums[generations.matured_rows(part.birth)] for part in window.slices]

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
            **self.strategy.state(),
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
        self.strategy.jump(by)
        self._next_window = frame

    def _plan(self, frames: range, schedule: Schedule, settled: int | None = None) -> WindowPlan:
        """How a window is trained. settled: the rounds that genesis has settled for already."""
        config, before = self._config, 0
        if settled is not None:
            before = config.genesis_iterations + settled * config.window_iterations
        brings_new = frames.start > 0 and len(frames) == config.swin_size
        return WindowPlan(
            frames=frames,
            schedule=schedule,
            settled=settled,
            before=before,
            begin=0 if frames.start else max(0, self._steps - before),
            brings_new=brings_new,
            newest_share=config.newest_share if brings_new else 0.0,
            together_share=config.together_share,
        )

    def _train(self, plan: WindowPlan) -> None:
        """Optimises the current generation on the frames of a window."""
        config, generations, frames = self._config, self._generations, plan.frames
        plan = self.strategy.begin_window(plan)
        if frames.start and not config.optimiser.carry_adam:
            generations.forget()
        generations.deselect()
        ages = generations.lifespans.ages(frames.start)
        if plan.is_genesis:
            ages[:] = 0
        self._resident.begin_window(ages, plan.together)
        for iteration in range(plan.begin, plan.schedule.iterations):
            frame = int(self._rng.integers(frames.start, frames.stop))
            if plan.newest_share and self._rng.random() < plan.newest_share:
                frame = frames[-1]
            camera = self._cameras.draw(self._rng, plan.error_share)
            layers = self.strategy.before_step(plan, iteration)
            self._step(plan, iteration, camera, frame, generations.selection(frame, layers))
            # The losses of half pictures are smaller: cameras are compared by those of whole ones.
            is_noted = layers is None and not plan.whole and not plan.schedule.is_half(iteration)
            self._unread.append(camera if is_noted else None)
            done = iteration + 1
            if not frames.start and config.mcmc.max_scale and done % BOUND_PERIOD == 0:
                everyone = generations.selection(frame)
                self._resident.bound_scales(everyone, config.mcmc.max_scale)
            is_due = done % PROGRESS_PERIOD == 0 or done == plan.schedule.iterations
            loss = self._note_losses(is_due)
            self.strategy.after_step(plan, done)
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
        rates = plan.schedule.rates(iteration, self._fit.extent_m)
        step = Step(
            camera, frame, plan.schedule.is_half(iteration), plan.whole, rates.means_lr_m,
            rates.calm, rates.noise_m, self._config.seed * 1_000_003 + self._steps,
            plan.level(iteration),
        )  # fmt: skip
        self._resident.step(step, selection)
        self._steps += 1
