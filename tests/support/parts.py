"""A tiny run in parts, and one process that does all its tasks."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from tests.support.suite.once import made_once
from tests.support.tiny_capture import write_dynamic3dgs
from trainer.parts.joiner import Joiner
from trainer.parts.raydriver import plan
from trainer.parts.task import Kind, Run, Task
from trainer.parts.worker import opened_worker
from trainer.run.config import TrainConfig, parse_with_preset
from trainer.run.prepare import prepare

FRAMES = 14
"""Two parts: of 8 frames, of which the last 4 are not the first part's to say, and of 6."""
SETTINGS = (
    "--num-gs", 100, "--genesis-iterations", 40, "--settle-rounds", 1, "--window-iterations", 20,
    "--segment-frames", 2, "--seam-frames", 3, "--warm-frames", 2, "--part-frames", 7,
    "--mcmc.relocate-period", 5, "--title", "parts",
)  # fmt: skip


class DiedError(Exception):
    """Stands for a worker's death."""


def capture_of(factory: pytest.TempPathFactory) -> Path:
    def make(folder: Path) -> None:
        write_dynamic3dgs(folder / "capture", num_cameras=4, num_frames=FRAMES)

    return made_once(factory, "capture of parts", make) / "capture"


def run_of(capture: Path | str, stream: Path | str) -> Run:
    config = parse_with_preset(TrainConfig, [str(word) for word in (capture, stream, *SETTINGS)])
    return plan(config, prepare(config))


def train(run: Run, do: Callable[[Task], None]) -> None:
    """Does all tasks, and joins the pieces as soon as they are there."""
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
    """Does a task in this process, again and again until it is done."""
    while True:
        try:
            with opened_worker(task, report, keep_s) as worker:
                worker.work()
            return
        except DiedError:
            pass
