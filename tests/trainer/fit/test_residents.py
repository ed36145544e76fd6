"""A training on a torch device shows what one in host arrays shows, and resumes."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
import pytest

from codec.splats import Splats
from player.render.cpu import render_splats
from tests.trainer.fit.test_leases import SLOTS, layout
from tests.trainer.fit.test_trainer import CONFIG, FRAMES, NEAR_M, Rendered, ring_camera, start
from trainer.fit.config import FitConfig
from trainer.fit.leasedslots import LeasedSlots
from trainer.fit.observer import Observer, Progress
from trainer.fit.strategy import WholeSlices
from trainer.fit.trainer import Trainer
from trainer.step.backend import Backend, BackendName
from trainer.step.device.device import DeviceBackend
from trainer.step.loss import psnr_db

SHORT = replace(CONFIG, genesis_iterations=150, window_iterations=60)
LEASED = replace(SHORT, swin_size=1, settle_rounds=1, scene_flow=True)


class Reported(Observer):
    """The losses of the progress reports."""

    def __init__(self) -> None:
        self.losses: list[float] = []

    def progressed(self, progress: Progress) -> None:
        self.losses.append(progress.loss)


def backend_of(name: BackendName, config: FitConfig) -> Backend:
    return config.backend(name, "cpu" if name == "torch" else None).backend


def trainer_of(
    backend: Backend, config: FitConfig, initial: Splats | None, *observers: Observer
) -> Trainer:
    leased = partial(LeasedSlots, layout=layout(1, *SLOTS[1]))
    return Trainer(
        config, Rendered(), initial, NEAR_M, backend=backend, observers=observers,
        strategy=leased if config.swin_size == 1 else WholeSlices,
    )  # fmt: skip


@pytest.mark.parametrize("config", [SHORT, LEASED], ids=["whole slices", "leases"])
def test_a_stopped_training_on_a_device_goes_on_as_if_it_had_not(config: FitConfig) -> None:
    config = replace(config, genesis_iterations=30, window_iterations=10)
    kept: list[dict[str, np.ndarray[Any, Any]]] = []

    class Keeping(Observer):
        def progressed(self, progress: Progress) -> None:
            if progress.first_frame == 0:
                kept.append({name: array.copy() for name, array in trainer.state().items()})

    trainer = trainer_of(backend_of("torch", config), config, start(), Keeping())
    for window in trainer.windows():
        kept.append({name: array.copy() for name, array in trainer.state().items()})
        if window.first_frame == 2:
            break
    for state in (kept[0], kept[-2]):
        other = trainer_of(backend_of("torch", config), config, None)
        other.restore(state)
        for window in other.windows():
            if window.first_frame == 2:
                break
        for name, array in other.state().items():
            np.testing.assert_array_equal(array, kept[-1][name], err_msg=name)


@pytest.mark.parametrize("config", [SHORT, LEASED], ids=["whole slices", "leases"])
def test_a_training_on_a_device_has_the_losses_and_pictures_of_numba(config: FitConfig) -> None:
    """Numba's losses are known at once, those of a device with the next report."""
    config = replace(config, genesis_iterations=60, window_iterations=10)
    names: tuple[BackendName, ...] = ("cpu", "torch")
    losses, pictures, camera = list[list[float]](), [], ring_camera(0.05, "between")
    for name in names:
        reported = Reported()
        trainer = trainer_of(backend_of(name, config), config, start(), reported)
        for window in trainer.windows():
            pictures.append(render_splats(trainer.shown(window.first_frame), camera, NEAR_M))
        losses.append(reported.losses)
    # Of genesis: later, a loss may be that of another camera.
    assert losses[1][:3] == pytest.approx(losses[0][:3], rel=2e-3)
    for ours, theirs in zip(pictures[:FRAMES], pictures[FRAMES:], strict=True):
        assert psnr_db(theirs, ours) > 40


@pytest.mark.parametrize("config", [SHORT, LEASED], ids=["whole slices", "leases"])
def test_within_a_window_only_numbers_cross(config: FitConfig) -> None:
    class Counting(Observer):
        def progressed(self, progress: Progress) -> None:
            crossed.append((progress.first_frame, crossing.crossed_bytes, crossing.picture_bytes))

    crossed = list[tuple[int, int, int]]()
    config = replace(
        config, genesis_iterations=100, window_iterations=80, settle_rounds=0,
        mcmc=replace(config.mcmc, relocate_period=1000),
    )  # fmt: skip
    backend = backend_of("torch", config)
    assert isinstance(backend, DeviceBackend)
    crossing = backend.crossing
    windows = trainer_of(backend, config, start(), Counting()).windows()
    next(windows)
    next(windows)
    for first_frame in (0, 1):
        told = [(crossed_bytes, p) for f, crossed_bytes, p in crossed if f == first_frame]
        assert len(told) >= 4
        (before, pictures), (after, later) = told[-2:]
        assert later == pictures  # every camera was used by then
        assert after - before < 20 * 100  # of 20 steps
    # Rows are copied between the windows, which shows that the counter works.
    genesis = [c for f, c, _ in crossed if f == 0]
    assert next(c for f, c, _ in crossed if f == 1) - genesis[-1] > 90 * 14 * 4
