"""The sliding-window trainer on a tiny generated scene."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from codec.camera import Camera
from codec.errors import InvalidError
from codec.slice import Slice, active_splats
from codec.splats import ARRAY_NAMES, Splats
from player.render.cpu import render_splats
from tests.support.hostile import refused
from trainer.capture.capture import Mask
from trainer.fit.config import FitConfig, WindowPlan
from trainer.fit.mcmc import McmcConfig
from trainer.fit.observer import Observer, Progress
from trainer.fit.strategy import Strategy, WholeSlices
from trainer.fit.trainer import Trainer
from trainer.lease.leases import LeaseConfig
from trainer.pictures.scale import Shot
from trainer.seed.gaussians import initial_splats
from trainer.step.backend import StepInput
from trainer.step.cpubackend import CpuBackend
from trainer.step.loss import Loss, psnr_db
from trainer.step.optimiser import CameraSpread
from trainer.step.raster import Parameters

NEAR_M = 0.2
FRAMES = 5
SWIN = 3


def ring_camera(angle: float, name: str) -> Camera:
    """A camera two metres from the origin that looks at it."""
    position = np.array([2 * np.sin(angle), -0.3, -2 * np.cos(angle)])
    forward = -position / np.linalg.norm(position)
    right = np.cross([0.0, 1.0, 0.0], forward)
    right /= np.linalg.norm(right)
    w2c = np.eye(4)
    w2c[:3, :3] = [right, np.cross(forward, right), forward]
    w2c[:3, 3] = -w2c[:3, :3] @ position
    return Camera(name, 48, 32, 45.0, 45.0, 24.0, 16.0, w2c)


def truth(frame: int) -> Splats:
    """Forty coloured blobs, a quarter of which drift."""
    rng = np.random.default_rng(3)
    means = rng.uniform(-0.6, 0.6, (40, 3))
    means[:10, 0] += 0.05 * frame
    return Splats(
        means.astype(np.float32),
        np.full((40, 3), np.log(0.12), np.float32),
        np.tile(np.array([1, 0, 0, 0], np.float32), (40, 1)),
        np.full(40, 3.0, np.float32),
        rng.uniform(-1.5, 1.5, (40, 1, 3)).astype(np.float32),
    )


class Rendered:
    """Pictures of the true scene from six cameras."""

    num_frames = FRAMES

    def __init__(self) -> None:
        self.cameras = [ring_camera(0.5 * i - 1.2, f"c{i}") for i in range(6)]
        self.asked: list[int] = []

    def shot(self, camera: int, frame: int) -> Shot:
        self.asked.append(frame)
        shown = np.clip(render_splats(truth(frame), self.cameras[camera], NEAR_M), 0, 1)
        return Shot(np.rint(shown * 255).astype(np.uint8), self.mask(camera, frame))

    def mask(self, camera: int, frame: int) -> Mask | None:
        return None


class Masked(Rendered):
    """The right third of every other camera is ignored; there the pictures show `garbage`."""

    def __init__(self, garbage: int) -> None:
        super().__init__()
        self.cameras = [c.resized(96, 64) for c in self.cameras]  # genesis uses half of it
        self.garbage = garbage

    def shot(self, camera: int, frame: int) -> Shot:
        shot = super().shot(camera, frame)
        if shot.mask is not None:
            shot.picture[shot.mask == 0] = self.garbage
        return shot

    def mask(self, camera: int, frame: int) -> Mask | None:
        mask = np.ones((64, 96), np.uint8)
        mask[:, 61:] = 0
        return None if camera % 2 else mask


CONFIG = FitConfig(
    num_gs=90, swin_size=SWIN, genesis_iterations=300, settle_rounds=0, window_iterations=100,
    mcmc=replace(McmcConfig(), relocate_period=25, opacity_reg=1e-3, scale_reg=1e-3),
)  # fmt: skip
QUICK = replace(CONFIG, genesis_iterations=40, window_iterations=20)


def start() -> Splats:
    rng = np.random.default_rng(5)
    points = rng.uniform(-0.7, 0.7, (90, 3)).astype(np.float32)
    return initial_splats(points, rng.integers(0, 255, (90, 3), dtype=np.uint8), 0)


def test_a_whole_run_is_algorithm_one() -> None:
    pictures, slices = Rendered(), list[Slice]()
    trainer = Trainer(CONFIG, pictures, start(), NEAR_M)
    for part in (part for window in trainer.windows() for part in window.slices):
        slices.append(part)
        if part.birth >= 0:
            # A slice matures when its last window is trained, not before.
            assert max(pictures.asked) == min(part.birth + SWIN - 1, FRAMES - 1)
    assert [s.birth for s in slices] == list(range(1 - SWIN, FRAMES))
    assert all(len(s.splats) == 30 for s in slices)
    assert min(pictures.asked) == 0
    held_out = ring_camera(0.3, "between")
    for frame in range(FRAMES):
        shown = active_splats(slices, frame, SWIN)
        # All num_gs live in every frame; late starts may hide a few.
        living = [s for s in slices if s.birth <= frame < s.birth + SWIN]
        assert sum(len(s.splats) for s in living) == CONFIG.num_gs
        assert 0.6 * CONFIG.num_gs <= len(shown) <= CONFIG.num_gs
        goal = np.clip(render_splats(truth(frame), held_out, NEAR_M), 0, 1)
        got, before = (
            psnr_db(np.clip(render_splats(splats, held_out, NEAR_M), 0, 1), goal)
            for splats in (shown, start())
        )
        assert got > max(before + 5, 20)


def test_matured_rows_never_change_and_parameters_carry_over() -> None:
    trainer = Trainer(QUICK, Rendered(), start(), NEAR_M)
    windows = trainer.windows()
    arrays = [array for name, array in trainer.state().items() if name.startswith("values")]
    assert len(arrays) == len(ARRAY_NAMES)
    genesis = next(windows)
    assert [s.birth for s in genesis.slices] == [-2, -1, 0]
    for array in arrays:
        assert (array[:90] == array[90:]).all()  # the next generation starts where this one ended
    frozen = [array[90:].copy() for array in arrays]
    (second,) = next(windows).slices
    lane = slice(90 + 30 * (second.birth % SWIN), 90 + 30 * (second.birth % SWIN) + 30)
    others = np.setdiff1d(np.arange(90), np.arange(lane.start, lane.stop) - 90)
    for array, before, matured in zip(arrays, frozen, second.splats.arrays, strict=True):
        assert (array[90:][others] == before[others]).all()
        assert (array[lane] == matured).all()
    assert (arrays[0][:90] != frozen[0]).any()


class Telling(Observer):
    """Records the calls, and the trainer's state at each report within genesis."""

    def __init__(self) -> None:
        self.told, self.states = list[str](), list[dict[str, Any]]()
        self.trainer: Trainer | None = None

    def window_begun(self, first_frame: int, done: int) -> None:
        self.told.append(f"begun {first_frame} at {done}")

    def progressed(self, progress: Progress) -> None:
        self.told.append(f"{progress.iteration} of {progress.iterations}")
        if self.trainer is not None and progress.first_frame == 0:
            state = self.trainer.state()
            self.states.append({name: array.copy() for name, array in state.items()})

    def window_ended(self, first_frame: int) -> None:
        self.told.append(f"ended {first_frame}")


def test_observers_are_told_of_each_window_once_its_slices_are_taken() -> None:
    telling = Telling()
    config = replace(QUICK, genesis_iterations=30)
    trainer = Trainer(config, Rendered(), start(), NEAR_M, observers=[Observer(), telling])
    for window in trainer.windows():
        telling.told.append(f"taken {window.first_frame} of {list(window.frames)}")
        assert trainer.next_window == window.first_frame + 1
    assert telling.told[:9] == [
        "begun 0 at 0", "20 of 30", "30 of 30", "taken 0 of [0, 1, 2]", "ended 0",
        "begun 1 at 0", "20 of 20", "taken 1 of [1, 2, 3]", "ended 1",
    ]  # fmt: skip
    assert telling.told[-2:] == ["taken 4 of [4]", "ended 4"]


def test_a_state_from_within_genesis_leads_to_the_same_gaussians() -> None:
    config = replace(QUICK, settle_rounds=2, window_iterations=30)
    # Pictures that are halved for a while.
    keeping = Telling()
    trainer = keeping.trainer = Trainer(config, Masked(0), start(), NEAR_M, observers=[keeping])
    whole = next(trainer.windows())
    for state, done in zip(keeping.states, (20, 40, 60, 70, 90, 100), strict=True):
        telling = Telling()
        other = Trainer(config, Masked(0), None, NEAR_M, observers=[telling])
        other.restore(state)
        window = next(other.windows())
        reported = [f"{n} of 100" for n in (40, 60, 70, 90, 100) if n > done]
        assert telling.told == [f"begun 0 at {done}", *reported]
        for one, part in zip(whole.slices, window.slices, strict=True):
            for array, mine in zip(one.splats.arrays, part.splats.arrays, strict=True):
                assert np.array_equal(array, mine)


def slices_of(pictures: Rendered, seed: int = 0) -> list[Slice]:
    trainer = Trainer(replace(QUICK, seed=seed), pictures, start(), NEAR_M)
    return [part for window in trainer.windows() for part in window.slices]


def test_the_same_seed_and_other_ignored_pixels_give_the_same_slices() -> None:
    black, white, other, grey = Masked(0), Masked(255), slices_of(Masked(0), seed=2), Masked(128)
    first = slices_of(black)
    for a, b in zip(first, slices_of(white), strict=True):
        assert (a.splats.means == b.splats.means).all()
        assert (a.splats.sh == b.splats.sh).all()
        assert (a.start_offsets == b.start_offsets).all()
    grey.mask = lambda camera, frame: None  # type: ignore[method-assign]
    for changed in (other, slices_of(grey)):
        assert (first[0].splats.means != changed[0].splats.means).any()


def test_relocation_lets_the_dead_start_with_their_targets_and_never_early() -> None:
    rng = np.random.default_rng(0)
    strategy = Trainer(CONFIG, Rendered(), start(), NEAR_M).strategy
    generations = strategy.fit.generations
    strategy.mature(range(SWIN))
    generations.adam.steps[:] = 20
    lifespans = generations.lifespans
    dead = lifespans.births == 1
    generations.values.logit_opacities[:90][dead] = -9
    moved = generations.relocate(~generations.follows, 3, CONFIG.mcmc.dead_opacity, rng)
    assert moved.tolist() == np.flatnonzero(dead).tolist()
    assert (lifespans.starts >= lifespans.births).all()
    assert (lifespans.expires == lifespans.births + SWIN).all()  # each keeps its own end
    assert (lifespans.starts[dead] > 1).any()  # some moved to a later slice
    assert (generations.values.logit_opacities[:90] > -6).all()
    assert (generations.adam.steps[dead] == 0).all()
    assert (generations.adam.steps == 20).any()


class Unrelocated(WholeSlices):
    """A strategy as docs/EXTENDING.md describes one: what is faint stays where it is."""

    def after_step(self, plan: WindowPlan, done: int) -> None:
        pass


def test_settling_relocates_what_is_faint_unless_a_strategy_does_not(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr("trainer.fit.strategy.RELOCATE_UNTIL", 1.0)

    def faint_share(strategy: type[Strategy]) -> float:
        window = next(Trainer(config, Rendered(), start(), NEAR_M, strategy=strategy).windows())
        logits = np.concatenate([part.splats.logit_opacities for part in window.slices])
        return float((logits < np.log(0.1 / 0.9) - 1e-3).mean())

    mcmc = replace(CONFIG.mcmc, settle_dead_opacity=0.1)
    config = replace(CONFIG, swin_size=1, settle_rounds=1, mcmc=mcmc)
    assert faint_share(WholeSlices) == 0
    assert faint_share(Unrelocated) > 0.1


def test_genesis_bounds_gaussians_and_keeps_the_mean_of_the_cameras_colours() -> None:
    for bound in (0.0, 0.03):
        config, pictures = replace(CONFIG, mcmc=replace(CONFIG.mcmc, max_scale=bound)), Rendered()
        trainer = Trainer(config, pictures, start(), NEAR_M)
        spread = CameraSpread.of(pictures.cameras)
        largest = max(
            float((np.exp(s.splats.log_scales).T / spread.distances_m(s.splats.means)).max())
            for s in next(trainer.windows()).slices
        )
        assert largest <= 0.03 * 1.05 if bound else largest > 0.05  # the last steps after it
    values = trainer.state()["colour"]
    np.testing.assert_allclose(values.mean(axis=0), [1, 1, 1, 0, 0, 0], atol=1e-5)
    assert np.ptp(values, axis=0).max() > 0


def test_settings_that_cannot_work_are_refused() -> None:
    bad: list[tuple[Callable[..., object], dict[str, float]]] = [
        (FitConfig, {"num_gs": 0, "swin_size": 256, "sh_degree": 4, "window_iterations": 0,
                     "newest_share": 1.5, "seed": -1}),
        (McmcConfig, {"relocate_period": 0, "dead_opacity": 0.0,
                      "settle_dead_opacity": 1.0, "renew_share": -0.1,
                      "scale_reg": float("nan"), "max_scale": -0.1}),
        (LeaseConfig, {"active_share": 1.1, "refresh_share": -1, "hold": 0.4}),
    ]  # fmt: skip
    for kind, values in bad:
        for name, value in values.items():
            refused(InvalidError, name, kind, **{name: value})
    refused(InvalidError, "num_gs", FitConfig, num_gs=91, swin_size=3)
    refused(InvalidError, "genesis_iterations", FitConfig, genesis_iterations=0, settle_rounds=0)


def test_fresh_adam_forgets_at_every_window_and_carried_adam_does_not() -> None:
    for carry in (False, True):
        config = replace(QUICK, optimiser=replace(CONFIG.optimiser, carry_adam=carry))
        trainer = Trainer(config, Rendered(), start(), NEAR_M)
        windows = trainer.windows()
        next(windows)
        next(windows)
        steps = int(trainer.state()["adam_steps"].max())
        assert steps > 40 if carry else steps <= 20


@pytest.mark.parametrize(("share", "window_share"), [(0.5, 0.0), (0.0, 0.3), (0.5, 0.3)])
def test_windows_begin_with_pictures_of_half_the_size(share: float, window_share: float) -> None:
    class Large(Rendered):
        def __init__(self) -> None:
            super().__init__()
            self.cameras = [c.resized(97, 66) for c in self.cameras]
            self.cameras[0] = self.cameras[0].resized(128, 64)  # sizes may differ

    class Watched(CpuBackend):
        def step(self, given: StepInput, gradients: Parameters) -> Loss:
            camera = given.view.camera
            assert given.shot.shape == (camera.height_px, camera.width_px)
            sizes.append((camera.width_px, camera.height_px))
            return super().step(given, gradients)

    sizes = list[tuple[int, int]]()
    config = replace(
        CONFIG, coarse_share=share, window_coarse_share=window_share, genesis_iterations=20,
        window_iterations=10,
    )  # fmt: skip
    backend = Watched(config.dssim_weight, 0, 0)
    windows = Trainer(config, Large(), start(), NEAR_M, backend=backend).windows()
    next(windows)
    next(windows)
    halves = [width < 97 for width, _ in sizes]
    first, later = int(20 * share), int(10 * window_share)
    assert halves == (
        [True] * first + [False] * (20 - first) + [True] * later + [False] * (10 - later)
    )
    assert set(sizes) <= {(48, 33), (64, 32), (97, 66), (128, 64)}
