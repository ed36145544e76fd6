"""A task on the cluster: what Ray runs, each time in a worker process of its own."""

from __future__ import annotations

import math
from typing import Any

from codec.errors import InvalidError, SwingsError
from codec.storage.openstorage import open_growing
from codec.stream.writer import SHAPE
from trainer.run.config import TrainConfig

from .task import Task

MAX_RETRIES = 30
"""Times that Ray runs a task again before the whole run fails."""

PASSING = OSError, MemoryError, RuntimeError
"""Errors that another try may not meet: of disks, networks, memory and GPUs."""


class Tally:
    """An actor that knows how many iterations of each task are done."""

    def __init__(self) -> None:
        self._before: dict[str, int] = {}
        self._done: dict[str, int] = {}

    def report(self, task: str, iterations: int) -> None:
        self._before.setdefault(task, iterations)
        self._done[task] = iterations

    def totals(self) -> tuple[int, int]:
        """Iterations done, and those of them that an earlier run had done."""
        return sum(self._done.values()), sum(self._before.values())


def remote_task(ray: Any, config: TrainConfig) -> Any:
    """`do_task` as a remote function with the resources, threads and retries of `config`."""
    environment = {
        # Numba reads both once, when it is loaded: so a process for each task, and not one before.
        "NUMBA_NUM_THREADS": str(math.ceil(config.worker_cpus)),
        "OMP_WAIT_POLICY": "passive",  # see trainer/__main__.py
    }
    return ray.remote(
        num_cpus=config.worker_cpus,
        num_gpus=config.worker_gpus,
        max_calls=1,
        max_retries=MAX_RETRIES,
        retry_exceptions=list(PASSING),
        runtime_env={"env_vars": environment},
    )(do_task)


def do_task(task: Task, tally: Any, warm_nodes: frozenset[str]) -> str | None:
    """Does a task in a process of Ray. Raises InvalidError where another try would be of no use.

    A process that compiles kernels may round differently from those that load them. So where this
    one has compiled any, and its node is not one of `warm_nodes`, it leaves the task undone and
    gives the node's ID: the next process there loads them.
    """
    import ray

    from trainer.run.warm import compile_kernels

    from .worker import opened_worker

    if open_growing(task.run.config.target, SHAPE).holds(task.last_path):
        return None  # the process that finished it died before it could report that
    node: str = ray.get_runtime_context().get_node_id()
    if compile_kernels(task.run.config.fit.sh_degree) and node not in warm_nodes:
        return node
    try:
        with opened_worker(task, lambda n: tally.report.remote(task.name, n)) as worker:
            worker.work()
    except SwingsError as error:
        raise InvalidError(f"{task.name}: {error}") from error
    return None


def task_result(ray: Any, ref: Any, task: Task) -> str | None:
    """The result of `do_task`. Raises InvalidError where Ray has given up on it."""
    try:
        node: str | None = ray.get(ref)
    except ray.exceptions.RayTaskError as error:
        if isinstance(error.cause, InvalidError):
            raise error.cause from error
        if isinstance(error.cause, PASSING):
            words = f"{type(error.cause).__name__}: {error.cause}".splitlines()[0]
            raise InvalidError(f"{task.name}: {words}, {MAX_RETRIES + 1} times") from error
        raise
    except ray.exceptions.RayError as error:
        words = str(error).splitlines()[0]
        raise InvalidError(f"{task.name}: {words} ({MAX_RETRIES + 1} times)") from error
    return node
