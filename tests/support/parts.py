"""A tiny run in parts, and one process that executes all its tasks."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from pathlib import Path

import tyro

from tests.support.tiny_capture import write_dynamic3dgs
from trainer.parts.joiner import Joiner
from trainer.parts.raydriver import plan
from trainer.parts.task import Kind, Run, Task
from trainer.parts.worker import opened_worker
from trainer.run.config import TrainConfig
from trainer.run.prepare import prepare
from trainer.run.preset import PRESETS
from trainer.run.warm import compile_kernels

FRAMES, PART_FRAMES = 22, 7
SETTINGS = (
    "--num-gs", 200, "--genesis-iterations", 40, "--settle-rounds", 1, "--window-iterations", 20,
    "--segment-frames", 2, "--seam-frames", 3, "--warm-frames", 2, "--part-frames", PART_FRAMES,
    "--mcmc.relocate-period", 5, "--title", "parts", "--lease.trade-share", 0.05,
)  # fmt: skip


class DiedError(Exception):
    """Stands for a worker's death."""


def capture_of(folder: Path) -> Path:
    """Writes a capture into `folder`."""
    write_dynamic3dgs(folder / "capture", num_cameras=4, num_frames=FRAMES)
    return folder / "capture"


def run_of(capture: Path | str, stream: Path | str) -> Run:
    args = [str(word) for word in (capture, stream, *SETTINGS)]
    config = tyro.cli(PRESETS["cpu"], args=args)
    assert isinstance(config, TrainConfig)
    return plan(config, prepare(config))


def train(run: Run, do: Callable[[Task], None]) -> None:
    """Executes all tasks, and joins the pieces as soon as they are there."""
    joiner = Joiner(run)
    for task in run.tasks:
        do(task)
        if task.kind is Kind.GENESIS:
            joiner.begin(resumed=False)
        for _ in joiner.go_on():
            pass
    assert joiner.finish().num_gs == run.config.fit.num_gs


def do_here(
    task: Task, report: Callable[[int], None] = lambda iterations: None, keep_s: float = 60.0
) -> None:
    """Executes a task in this process, and repeats it until it is done."""
    while True:
        try:
            with opened_worker(task, report, keep_s) as worker:
                worker.work()
            return
        except DiedError:
            pass


def train_in_process(run: Run) -> None:
    """Executes all tasks in one process, after another one has compiled all kernels."""
    with ProcessPoolExecutor(1, get_context("spawn"), max_tasks_per_child=1) as pool:
        pool.submit(compile_kernels, run.config.fit.sh_degree).result()
        pool.submit(train, run, do_here).result()
