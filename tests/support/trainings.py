"""Short trainings: in this process, or in one that sends itself a signal on the way."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

from rich.console import Console

from tests.support import commands
from trainer.fit.observer import Observer, Progress
from trainer.run.config import TrainConfig, parse_with_preset
from trainer.run.job import train_stream
from trainer.run.monitor import LOG_NAME
from trainer.run.outputs import SNAPSHOT_FOLDER


def train_here(*words: object, observers: Sequence[Observer] = ()) -> TrainConfig:
    """Does what `swings-train WORDS` does, in this process."""
    config = parse_with_preset(TrainConfig, [*map(str, words)])
    train_stream(config, Console(quiet=True), observers=observers)
    return config


def contents(stream: Path) -> dict[str, bytes]:
    """The files of a stream without those only for people: keyframes, and the log, which contains
    times."""
    names = [str(path.relative_to(stream)) for path in stream.rglob("*") if path.is_file()]
    people = (LOG_NAME, SNAPSHOT_FOLDER)
    return {name: (stream / name).read_bytes() for name in names if not name.startswith(people)}


def run_until(
    number: signal.Signals, frame: int, *words: object
) -> subprocess.CompletedProcess[str]:
    """Runs `swings-train WORDS` in a process that gets the signal within the window of `frame`."""
    entry = "tests.support.trainings:train_signalled"
    return commands.run(entry, int(number), frame, *words)


def train_signalled() -> None:
    from trainer.__main__ import train
    from trainer.run import job
    from trainer.run.monitor import Monitor

    number, frame = int(sys.argv.pop(1)), int(sys.argv.pop(1))

    class Signalling(Monitor):
        def progressed(self, progress: Progress) -> None:
            super().progressed(progress)
            if progress.first_frame == frame:
                os.kill(os.getpid(), number)

    vars(job)["Monitor"] = Signalling
    train()
