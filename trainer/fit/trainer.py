"""Sliding-window training (paper, Algorithm 1): pictures in, one matured slice per frame out.

Nothing here opens a file or prints; the pictures come from a `Pictures`, progress leaves through a
callback, and slices leave through an iterator.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import numpy.typing as npt

from codec.camera import Camera
from codec.errors import InvalidError
from codec.slice import MAX_SWIN_SIZE, Slice
from codec.splats import Splats
from trainer.pictures.feed import Pictures
from trainer.pictures.shot import Shot
from trainer.step.backend import Backend, BackendName, make_backend
from trainer.step.raster import Parameters, View

from .colour import CameraColour
from .lifespans import Lifespans
from .mcmc import McmcConfig, relocate
from .optimiser import Adam, OptimiserConfig, add_noise
from .renew import Comparer, missing_splats

Floats = npt.NDArray[np.float32]
Ints = npt.NDArray[np.int32]

FALLBACK_FAR_M = 100.0
"""Where something new is looked for, at most, when nobody knows."""


@dataclass(frozen=True)
class FitConfig:
    """What the sliding-window training does; times are frames, sizes Gaussians."""

    num_gs: int = 20_000
    """Gaussians active in a frame. Paper: 200,000 on a GPU; 20,000 suits two CPU cores."""
    swin_size: int = 5
    """Frames a Gaussian lives. Paper, section 8.1."""
    sh_degree: int = 0
    """Degree of the colour's spherical harmonics, 0 or 1. The paper trains 1 and streams 0."""
    genesis_iterations: int = 5_000
    """Iterations of the first window. Paper: 30,000 on a GPU."""
    coarse_share: float = 0.6
    """Share of genesis, its beginning, that sees pictures of half the size: shapes settle where the
    cameras agree before detail can be learned by heart. 0 to switch it off."""
    window_iterations: int = 800
    """Iterations of every later window. Paper: 2,000 on a GPU."""
    newest_share: float = 0.5
    """Share of a window's iterations spent on its newest frame, if no earlier window has seen
    it."""
    dssim_weight: float = 0.2
    """Weight of 1 - SSIM beside L1. 3DGS."""
    colour_lr: float = 1e-3
    """Learning rate of the per-camera colour correction; 0 switches it off."""
    seed: int = 0
    """Of every random choice."""
    optimiser: OptimiserConfig = field(default_factory=OptimiserConfig)
    """Learning rates."""
    mcmc: McmcConfig = field(default_factory=McmcConfig)
    """Relocation, noise, regularisers."""

    def __post_init__(self) -> None:
        if not 1 <= self.swin_size <= MAX_SWIN_SIZE:
            raise InvalidError(f"swin_size {self.swin_size}: choose 1 to {MAX_SWIN_SIZE}")
        if self.seed < 0:
            raise InvalidError(f"seed {self.seed}: choose 0 or more")
        if self.num_gs < self.swin_size or self.num_gs % self.swin_size:
            raise InvalidError(
                f"num_gs {self.num_gs} is not a multiple of swin_size {self.swin_size}"
            )
        if self.sh_degree not in (0, 1):
            raise InvalidError(f"sh_degree {self.sh_degree}: choose 0 or 1")
        if self.genesis_iterations < 1 or self.window_iterations < 1:
            raise InvalidError("genesis_iterations and window_iterations must be at least 1")
        for name in ("coarse_share", "newest_share", "dssim_weight"):
            if not 0 <= getattr(self, name) <= 1:
                raise InvalidError(f"{name} {getattr(self, name):g}: choose 0 to 1")

    def backend(self, name: BackendName) -> Backend:
        """The backend `name` for this loss. Raises InvalidError where it cannot run."""
        return make_backend(name, self.dssim_weight, self.mcmc.opacity_reg, self.mcmc.scale_reg)


@dataclass(frozen=True, slots=True)
class Progress:
    """Where training stands."""

    first_frame: int  # of the window
    iteration: int  # done in this window
    iterations: int  # of this window
    loss: float


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
        near_m: float,
        far_m: float = FALLBACK_FAR_M,
        on_progress: Callable[[Progress], None] = lambda progress: None,
        backend: Backend | None = None,
    ) -> None:
        """initial: num_gs Gaussians to begin with; None when `restore` follows. backend: by default
        the CPU's."""
        if initial is not None and (len(initial), initial.sh_degree) != (
            config.num_gs,
            config.sh_degree,
        ):
            raise InvalidError(f"{len(initial)} initial Gaussians for num_gs {config.num_gs}")
        self.config = config
        self.pictures = pictures
        self.views = [View.prepare(c, near_m) for c in pictures.cameras]
        smallest_px = min(min(c.width_px, c.height_px) for c in pictures.cameras)
        # Below this the windows of SSIM would see little but the border.
        self.coarse_share = config.coarse_share if smallest_px >= 64 else 0.0
        self.coarse_views = [
            View.prepare(c.halved(), near_m) for c in pictures.cameras if self.coarse_share
        ]
        self.lifespans = Lifespans(config.num_gs, config.swin_size)
        self.adam = Adam(config.num_gs, config.sh_degree, config.optimiser)
        self.colour = CameraColour(len(self.views), config.colour_lr)
        # The generation being optimised above, the matured generation of the same slots below.
        self.values = Parameters.zeros(2 * config.num_gs, config.sh_degree)
        self.values.quats[:, 0] = 1
        if initial is not None:
            for name in Parameters.__slots__:
                getattr(self.values, name)[: config.num_gs] = getattr(initial, name)
        self.gradients = Parameters.zeros(config.num_gs, config.sh_degree)
        self.backend = backend or config.backend("cpu")
        self.comparer = Comparer(pictures.cameras, near_m)
        self.near_m, self.far_m = near_m, far_m
        self.extent_m = scene_extent_m(pictures.cameras)
        self.rng = np.random.default_rng(config.seed)
        self.on_progress = on_progress
        self.next_window = 0
        """First frame of the window to train next."""
        self._steps = 0

    def windows(self) -> Iterator[list[Slice]]:
        """Trains the rest of the video; gives the slices that mature after each window, in the
        order of birth: the whole of frame 0 after genesis, then one at a time."""
        while self.next_window < self.pictures.num_frames:
            if self.next_window == 0:
                self.train_window(0, self.config.genesis_iterations)
                self._stagger()
            else:
                if not self.config.optimiser.carry_adam:
                    self.adam.reset(np.arange(self.config.num_gs))
                self.train_window(self.next_window, self.config.window_iterations)
            self.next_window += 1
            yield list(self._mature(self.next_window))

    def state(self) -> dict[str, npt.NDArray[Any]]:
        """Everything that changes while training; `restore` takes it back. Views, not copies."""
        lifespans, colour = self.lifespans, self.colour
        arrays: dict[str, npt.NDArray[Any]] = {
            "adam_steps": self.adam.steps,
            "births": lifespans.births,
            "starts": lifespans.starts,
            "expires": lifespans.expires,
            "matured_starts": lifespans.matured_starts,
            "matured_expires": lifespans.matured_expires,
            **colour.state(),
        }
        for name, parameters in (
            ("values", self.values),
            ("first", self.adam.first),
            ("second", self.adam.second),
        ):
            for i, array in enumerate(parameters.arrays()):
                arrays[f"{name}{i}"] = array
        random = json.dumps(self.rng.bit_generator.state)
        arrays["random"] = np.frombuffer(random.encode(), np.uint8)
        arrays["counters"] = np.array([self.next_window, self._steps], np.int64)
        return arrays

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
        self.rng.bit_generator.state = json.loads(state["random"].tobytes())
        self.next_window, self._steps = (int(n) for n in state["counters"])

    def _stagger(self) -> None:
        rows = self.config.num_gs
        # At random: slots hand their Gaussians on for the whole video, so slices that are unequal
        # now would stay so, and frames alternate in quality and layers in worth.
        order = self.lifespans.stagger(self.rng.permutation(rows))
        for array in self.values.arrays():
            array[:rows] = array[:rows][order]
        self.adam.permute(order)

    def _mature(self, first_frame: int) -> Iterator[Slice]:
        """Freezes what no frame from `first_frame` on may change; parameters carry over."""
        for birth in self.lifespans.due(first_frame):
            rows = self.lifespans.mature(birth)
            num_gs = self.config.num_gs
            matured = slice(rows.start + num_gs, rows.stop + num_gs)
            for array in self.values.arrays():
                array[matured] = array[rows]
            offsets = self.lifespans.matured_starts[rows] - birth
            yield Slice(birth, self.splats(matured), offsets.astype(np.uint8))

    def splats(self, rows: slice | Ints) -> Splats:
        """A copy of the parameters `rows`."""
        return Splats(*(array[rows].copy() for array in self.values.arrays()))

    def shown(self, frame: int) -> Splats:
        """What shows at `frame`, as trained so far; of the window just trained or to be trained."""
        return self.splats(self.lifespans.active_rows(frame))

    def train_window(self, first_frame: int, iterations: int) -> None:
        """Optimises the current generation on the frames [first_frame, first_frame + swin_size)."""
        config = self.config
        last_frame = min(first_frame + config.swin_size, self.pictures.num_frames) - 1
        genesis = first_frame == 0
        # Neither genesis nor the last windows of a video.
        brings_new = not genesis and last_frame == first_frame + config.swin_size - 1
        if brings_new:
            self._renew(last_frame)
        active = {f: self.lifespans.active_rows(f) for f in range(first_frame, last_frame + 1)}
        ages = self.lifespans.ages(first_frame)
        if genesis:
            ages[:] = 0
        for iteration in range(iterations):
            frame = int(self.rng.integers(first_frame, last_frame + 1))
            if brings_new and self.rng.random() < config.newest_share:
                frame = last_frame
            camera = int(self.rng.integers(len(self.views)))
            means_lr = self._means_lr(genesis, iteration / iterations)
            coarse = genesis and iteration < self.coarse_share * iterations
            view, shot = self.views[camera], self.pictures.shot(camera, frame)
            if coarse:
                view, shot = self.coarse_views[camera], shot.half()
            loss = self._step(camera, view, shot, active[frame], means_lr, ages, genesis)
            done = iteration + 1
            period = config.mcmc.relocate_period
            if done % period == 0 and done <= config.mcmc.relocate_until * iterations:
                self._relocate(last_frame)
                active = {f: self.lifespans.active_rows(f) for f in active}
            if done % 20 == 0 or done == iterations:
                self.on_progress(Progress(first_frame, done, iterations, loss))

    def _means_lr(self, genesis: bool, progress: float) -> float:
        o = self.config.optimiser
        start, end = (
            (o.means_lr, o.means_lr_end) if genesis else (o.window_means_lr, o.window_means_lr_end)
        )
        return float(self.extent_m * start * (end / start) ** progress)

    def _step(
        self,
        camera: int,
        view: View,
        shot: Shot,
        rows: Ints,
        means_lr: float,
        ages: Floats,
        genesis: bool,
    ) -> float:
        config, mcmc = self.config, self.config.mcmc
        loss = self.backend.step(
            self.values, rows, view, shot, self.colour.gain(camera), self.colour.bias(camera),
            config.num_gs, self.gradients,
        )  # fmt: skip
        trainable = rows[rows < config.num_gs]
        self.adam.step(self.values, self.gradients, trainable, means_lr, ages)
        self.colour.step(camera, loss.gain_grad, loss.bias_grad)
        noise_lr = mcmc.noise_lr if genesis else mcmc.window_noise_lr
        add_noise(
            self.values.means, self.values.log_scales, self.values.quats,
            self.values.logit_opacities, trainable, np.float32(noise_lr * means_lr),
            np.float32(mcmc.dead_opacity), np.float32(100), config.seed * 1_000_003 + self._steps,
        )  # fmt: skip
        self._steps += 1
        return loss.value

    def _renew(self, last_frame: int) -> Ints:
        """Places the least contributing Gaussians of every slice where `last_frame`, which no
        window saw before, shows what is not rendered. They show from then on. Gives their rows."""
        lifespans, config = self.lifespans, self.config
        each = round(config.mcmc.renew_share * lifespans.slice_size)
        if each == 0:
            return np.zeros(0, np.int32)
        # Whatever has matured before this window expires before its last frame.
        rows = lifespans.active_rows(last_frame)
        seen, weights = self.comparer.compare(
            self.values, rows, self.pictures, last_frame, self.colour
        )
        by_weight = rows[np.argsort(weights, kind="stable")]
        # The least important of every slice, slice by slice in turn.
        births = lifespans.births[by_weight]
        slices = [by_weight[births == birth][:each] for birth in np.unique(births)]
        order = np.array([row for turn in zip(*slices, strict=True) for row in turn], np.int32)
        found = missing_splats(
            seen, len(order), self.near_m, self.far_m, config.sh_degree, self.rng
        )
        renewed = order[: len(found)]
        for name in Parameters.__slots__:
            getattr(self.values, name)[renewed] = getattr(found, name)
        lifespans.starts[renewed] = last_frame
        self.adam.reset(renewed)
        return renewed

    def _relocate(self, last_frame: int) -> None:
        """Moves dead Gaussians of every slice in the window to living ones born no earlier.

        A dead one keeps its expiry and takes over its target's start, so it may show later than its
        slice is due (the paper's "birth" and "start").
        """
        lifespans, num_gs = self.lifespans, self.config.num_gs
        min_opacity = self.config.mcmc.dead_opacity
        births = np.unique(lifespans.births)
        for birth in births[births <= last_frame]:
            logits = self.values.logit_opacities[:num_gs]
            is_dead = logits <= np.log(min_opacity / (1 - min_opacity))
            dead = np.flatnonzero(is_dead & (lifespans.births == birth))
            # Slices that no frame of the video shows yet must not attract any.
            alive = np.flatnonzero(
                ~is_dead & (lifespans.births >= birth) & (lifespans.starts <= last_frame)
            )
            targets = relocate(self.values, dead, alive, min_opacity, self.rng)
            if len(targets):
                lifespans.starts[dead] = lifespans.starts[targets]
                self.adam.reset(dead)
                self.adam.reset(np.unique(targets))
