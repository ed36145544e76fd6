"""A task in a process of its own, so that it compiles and threads as a run without Ray does."""

from __future__ import annotations

import math
import os
import subprocess
import sys
import tempfile
from collections.abc import Callable
from typing import Any

from codec.errors import InvalidError

from .task import Task

FAILED = 3
"""Exit status of a task's process where trying again is of no use; its stderr says why."""

MAX_WORDS_CHARS = 2_000
"""Of what a process said when it failed."""

MAX_DEATHS = 30
"""Times that the process of a task may be killed before a worker gives up."""


class Tally:
    """Counts, on the cluster, the iterations that tasks have done; what is done again counts
    once."""

    def __init__(self) -> None:
        self._done: dict[str, int] = {}

    def begin(self, task: str) -> None:
        self._done[task] = 0

    def add(self, task: str, iterations: int) -> None:
        # Started anew, after its node has died, it knows of no task.
        self._done[task] = self._done.get(task, 0) + iterations

    def total(self) -> int:
        return sum(self._done.values())


def do(task: Task, tally: Any) -> None:
    """Does a task in a process of its own, again if that is killed. tally: the actor. Raises
    InvalidError where another try would be of no use."""
    for _ in range(MAX_DEATHS):
        tally.begin.remote(task.name)
        status, words = run_task(task, lambda n: tally.add.remote(task.name, n))
        if not status:
            return
        if status == FAILED:
            break
    raise InvalidError(words or f"its process ended with {status}, {MAX_DEATHS} times")


def run_task(task: Task, tell: Callable[[int], object]) -> tuple[int, str]:
    """Does a task in a process of its own; gives its exit status and its last words."""
    with tempfile.NamedTemporaryFile("w", suffix=".json") as told, tempfile.TemporaryFile() as said:
        told.write(task.to_json())
        told.flush()
        process = subprocess.Popen(
            [sys.executable, "-m", "trainer.parts", told.name],
            env={**os.environ, "NUMBA_NUM_THREADS": str(math.ceil(task.run.config.worker_cpus))},
            stdin=subprocess.PIPE,  # ends when this process does
            stdout=subprocess.PIPE,
            stderr=said,
            text=True,
        )
        with process:
            assert process.stdout is not None
            for line in process.stdout:
                tell(int(line))
        said.seek(0)
        words = said.read().decode(errors="replace").strip()[-MAX_WORDS_CHARS:]
    return process.returncode, words
