"""Time of a training step on the CPU, stage by stage, for several numbers of Gaussians and
resolutions; and time of loss and gradients compared with plain torch on the same inputs and cores,
in turns."""

from __future__ import annotations

import importlib.util
import os
import time
from collections.abc import Callable
from dataclasses import dataclass

from codec.arrays import Floats

os.environ.setdefault("OMP_WAIT_POLICY", "passive")

import numba
import numpy as np
from rich.console import Console
from rich.table import Table

from codec.camera import Camera
from codec.console import run_command
from player.render.blend import blend_tiles, list_tiles
from player.render.project import Projection, project_kernel
from trainer.pictures.scale import Shot
from trainer.step.active import trained_ends
from trainer.step.backend import Backend, StepInput
from trainer.step.backward import PAIR_GRADIENT, blend_tiles_backward
from trainer.step.cpubackend import CpuBackend
from trainer.step.loss import Workspace, photometric_loss
from trainer.step.optimiser import GATE_STEEPNESS, Adam, OptimiserConfig, add_noise
from trainer.step.raster import Parameters, Scratch, View, backward, render

REPEATS = 15
CASES = [(5_000, 320, 180), (20_000, 320, 180), (20_000, 640, 360), (60_000, 640, 360)]
"""Number of Gaussians, width and height in pixels."""
TORCH_REPEATS = 5
SHARE_CASE = CASES[2]
SHARES = (1.0, 0.5, 0.3, 0.15, 0.05)
"""Shares of the Gaussians that are trained."""
TRAINED_AROUND_M = (0.8, 0.3, 1.5)
"""Centre of the trained Gaussians, in the half of the scene that is far from the camera."""
NEAR_M = 0.2
DSSIM_WEIGHT = 0.2
MEANS_LR_M = 1e-4
NO_TORCH = "torch is missing, so there is no comparison; install the extra torch"


def median_ms(work: Callable[[], object], repeats: int = REPEATS) -> float:
    work()
    times = []
    for _ in range(repeats):
        start = time.perf_counter()
        work()
        times.append(time.perf_counter() - start)
    return 1e3 * float(np.median(times))


def scene(count: int) -> Parameters:
    """Gaussians with sizes and opacities like a trained scene: many small ones, few large ones."""
    rng = np.random.default_rng(0)
    values = Parameters.zeros(count, 0)
    values.means[:] = rng.uniform(-2, 2, (count, 3))
    values.log_scales[:] = rng.normal(np.log(0.03 * (20_000 / count) ** (1 / 3)), 0.6, (count, 3))
    values.quats[:] = rng.normal(size=(count, 4))
    values.logit_opacities[:] = rng.normal(-1, 1.5, count)
    values.sh[:, 0] = rng.normal(size=(count, 3))
    return values


def bench_camera(width_px: int, height_px: int) -> Camera:
    w2c = np.eye(4)
    w2c[2, 3] = 3.0
    return Camera(
        "bench", width_px, height_px, width_px / 2, width_px / 2, width_px / 2, height_px / 2, w2c
    )


def bench_target(width_px: int, height_px: int) -> Floats:
    """(3, H, W) noise in 0..1."""
    return np.random.default_rng(1).random((3, height_px, width_px)).astype(np.float32)


def bench_shot(width_px: int, height_px: int) -> Shot:
    pixels = 255 * bench_target(width_px, height_px).transpose(1, 2, 0)
    return Shot(np.ascontiguousarray(pixels, np.uint8))


@dataclass(frozen=True, slots=True)
class StepTimes:
    """Seconds of one step."""

    whole: float
    rasteriser: float
    """Forward (project, tile lists, blend) and backward (blend, project)."""


class Step:
    """A training step of the CPU back end on the scene of `count` Gaussians."""

    def __init__(self, count: int, width_px: int, height_px: int) -> None:
        self.count, self.values = count, scene(count)
        self.view = View.prepare(bench_camera(width_px, height_px), NEAR_M)
        self.rows = np.arange(count, dtype=np.int32)
        self.target = bench_target(width_px, height_px)
        self.work, self.scratch = Workspace(self.target.shape), Scratch()
        self.gain, self.bias = np.ones(3, np.float32), np.zeros(3, np.float32)
        self.gradients, self.ages = Parameters.zeros(count, 0), np.zeros(count, np.float32)
        self.optimiser = Adam(count, 0, OptimiserConfig())

    def step(self) -> StepTimes:
        begin = time.perf_counter()
        rendered = render(self.values, self.rows, self.view, self.scratch)
        forward = time.perf_counter()
        loss = photometric_loss(
            rendered.picture, self.target, DSSIM_WEIGHT, self.gain, self.bias, self.work
        )
        before = time.perf_counter()
        backward(rendered, self.values, loss.picture_grad, self.count, self.gradients)
        after = time.perf_counter()
        self.adam()
        self.noise()
        return StepTimes(time.perf_counter() - begin, forward - begin + after - before)

    def adam(self) -> None:
        self.optimiser.step(self.values, self.gradients, self.rows, MEANS_LR_M, self.ages)

    def noise(self) -> None:
        add_noise(
            *self.values.arrays[:4], self.rows,
            np.float32(0), np.float32(0.005), np.float32(GATE_STEEPNESS), 1,
        )  # fmt: skip


def stages(count: int, width_px: int, height_px: int, repeats: int = REPEATS) -> dict[str, float]:
    """Milliseconds of each stage and of the whole step; per cent of the whole step outside the
    rasteriser (measured within each step) and outside blending alone."""
    ours = Step(count, width_px, height_px)
    values, view, rows = ours.values, ours.view, ours.rows
    rendered = render(values, rows, view)
    loss = photometric_loss(rendered.picture, ours.target, DSSIM_WEIGHT, ours.gain, ours.bias)
    p, lists = rendered.projection, rendered.lists
    pair_grads = np.empty((len(lists.pairs), PAIR_GRADIENT), np.float32)
    spare, moves = Projection.allocate(count), np.ones(count, np.bool_)
    ends, order = trained_ends(lists, moves)
    work: dict[str, Callable[[], object]] = {
        "project": lambda: project_kernel(
            *values.arrays, rows, view.vector, view.tiles_x, view.tiles_y,
            spare.projected, spare.depths, spare.tile_boxes,
        ),
        "tile lists": lambda: list_tiles(p, view.tiles_x, view.tiles_y),
        "blend": lambda: blend_tiles(
            p.projected, lists.starts, lists.gaussians, lists.order, view.tiles_x, rendered.picture
        ),
        "loss": lambda: photometric_loss(
            rendered.picture, ours.target, DSSIM_WEIGHT, ours.gain, ours.bias, ours.work
        ),
        "blend backward": lambda: blend_tiles_backward(
            p.projected, lists.starts, ends, lists.gaussians, lists.pairs, moves, order,
            view.tiles_x, rendered.picture, loss.picture_grad, pair_grads,
        ),
        "whole backward": lambda: backward(
            rendered, values, loss.picture_grad, count, ours.gradients
        ),
        "Adam": ours.adam,
        "noise": ours.noise,
    }  # fmt: skip
    result = {name: median_ms(run, repeats) for name, run in work.items()}
    ours.step()
    times = [ours.step() for _ in range(repeats)]
    result["whole step"] = 1e3 * float(np.median([t.whole for t in times]))
    result["pairs"] = float(len(lists.pairs))
    outside = float(np.median([1 - t.rasteriser / t.whole for t in times]))
    blending = result["blend"] + result["blend backward"]
    result["outside rasteriser"] = 100 * outside
    result["outside blending"] = 100 * (1 - blending / result["whole step"])
    return result


def against_torch(
    count: int, width_px: int, height_px: int, repeats: int = TORCH_REPEATS
) -> tuple[float, float]:
    """Milliseconds of loss and gradients by numba and by plain torch on the CPU: medians of steps
    that take turns."""
    import torch

    from trainer.step.device.backends import TorchBackend

    torch.set_num_threads(numba.get_num_threads())
    view = View.prepare(bench_camera(width_px, height_px), NEAR_M)
    values, rows = scene(count), np.arange(count, dtype=np.int32)
    shot, gradients = bench_shot(width_px, height_px), Parameters.zeros(count, 0)
    gain, bias = np.ones(3, np.float32), np.zeros(3, np.float32)

    given = StepInput(values, rows, view, shot, gain, bias, count)

    def step_s(backend: Backend) -> float:
        start = time.perf_counter()
        backend.step(given, gradients)
        return time.perf_counter() - start

    ours, theirs = CpuBackend(DSSIM_WEIGHT, 0, 0), TorchBackend(DSSIM_WEIGHT, 0, 0, "cpu")
    step_s(ours)
    step_s(theirs)
    times = []
    for _ in range(repeats):
        # A numba step is short, so that a single one would measure the change-over.
        times.append((np.median([step_s(ours) for _ in range(3)]), step_s(theirs)))
    median_s = np.median(np.array(times), axis=0)
    return 1e3 * float(median_s[0]), 1e3 * float(median_s[1])


@dataclass(frozen=True, slots=True)
class ShareTimes:
    """Median milliseconds of a backend's step in which a share of the Gaussians is trained."""

    whole_ms: float
    some_tiles_ms: float
    active_percent: float
    """Percentage of the picture's tiles that the trained Gaussians reach."""


def step_at(
    share: float, count: int, width_px: int, height_px: int, repeats: int = REPEATS
) -> ShareTimes:
    """Times steps that train a share of the Gaussians, those nearest to a point. Steps on the whole
    picture and steps on the reached tiles take turns."""
    values, rows = scene(count), np.arange(count, dtype=np.int32)
    nearest = np.argsort(np.linalg.norm(values.means - TRAINED_AROUND_M, axis=1))
    for array in values.arrays:
        array[:] = array[nearest]
    view = View.prepare(bench_camera(width_px, height_px), NEAR_M)
    shot = bench_shot(width_px, height_px)
    backend, gradients = CpuBackend(DSSIM_WEIGHT, 0, 0), Parameters.zeros(count, 0)
    gain, bias = np.ones(3, np.float32), np.zeros(3, np.float32)
    trainable, covered = round(share * count), 0.0
    times = []
    for _ in range(repeats + 1):
        both = []
        for whole in (True, False):
            given = StepInput(values, rows, view, shot, gain, bias, trainable, whole)
            start = time.perf_counter()
            loss = backend.step(given, gradients)
            both.append(1e3 * (time.perf_counter() - start))
            covered = loss.covered
        times.append(both)
    whole_ms, some_ms = np.median(times[1:], axis=0)
    return ShareTimes(float(whole_ms), float(some_ms), 100 * covered)


def stage_table() -> Table:
    table = Table(title=f"training step, ms (medians of {REPEATS})")
    columns = None
    for case in CASES:
        found = stages(*case)
        if columns is None:
            columns = list(found)
            for name in ("Gaussians", "size", *columns):
                table.add_column(name, justify="right")
        texts = [
            f"{value:.0f} %"
            if name.startswith("outside")
            else f"{value:.{0 if name == 'pairs' else 1}f}"
            for name, value in found.items()
        ]
        table.add_row(str(case[0]), f"{case[1]}x{case[2]}", *texts)
    return table


def torch_table() -> Table:
    table = Table(
        title=f"loss and gradients beside plain torch, {numba.get_num_threads()} threads each, in "
        f"turns, ms (medians of {TORCH_REPEATS})"
    )
    for name in ("Gaussians", "size", "ours", "plain torch", "ratio"):
        table.add_column(name, justify="right")
    for case in CASES:
        mine_ms, torch_ms = against_torch(*case)
        table.add_row(
            str(case[0]), f"{case[1]}x{case[2]}",
            f"{mine_ms:.1f}", f"{torch_ms:.0f}", f"{torch_ms / mine_ms:.0f}x",
        )  # fmt: skip
    return table


def share_table() -> Table:
    count, width_px, height_px = SHARE_CASE
    table = Table(
        title=f"loss and gradients of {count} Gaussians at {width_px}x{height_px}, some of them "
        f"trained, in turns, ms (medians of {REPEATS})"
    )
    for name in ("trained", "active tiles", "whole picture", "what matters", "ratio"):
        table.add_column(name, justify="right")
    for share in SHARES:
        found = step_at(share, *SHARE_CASE)
        table.add_row(
            f"{share:.0%}", f"{found.active_percent:.0f} %", f"{found.whole_ms:.1f}",
            f"{found.some_tiles_ms:.1f}", f"{found.some_tiles_ms / found.whole_ms:.2f}",
        )  # fmt: skip
    return table


@dataclass(frozen=True, slots=True)
class TrainBenchConfig:
    """Times a training step stage by stage."""

    torch: bool = True
    """Also time loss and gradients, compared with plain torch."""


def run(config: TrainBenchConfig) -> None:
    console = Console(width=180)
    console.print(stage_table())
    console.print(share_table())
    if not config.torch:
        return
    if importlib.util.find_spec("torch") is None:
        console.print(NO_TORCH)
        return
    console.print(torch_table())


def main() -> None:
    run_command(TrainBenchConfig, run, "scripts/bench train", "Times a training step.")


if __name__ == "__main__":
    main()
