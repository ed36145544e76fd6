"""Checks and messages about a cluster before it gets work."""

from __future__ import annotations

import io
import sys
from contextlib import redirect_stdout
from types import SimpleNamespace
from typing import Any

import pytest
from rich.console import Console

from codec.errors import InvalidError
from trainer.parts.cluster import RayOutput, look_for_room, num_workers
from trainer.run.config import TrainConfig

SMALL = {"Alive": True, "Resources": {"CPU": 3.0}}
LARGE = {"Alive": True, "Resources": {"CPU": 8.0, "GPU": 1.0}}
GONE = {"Alive": False, "Resources": {"CPU": 64.0, "GPU": 8.0}}


def config(**claims: Any) -> TrainConfig:
    return TrainConfig("capture", "stream", **claims)


def told(nodes: list[dict[str, Any]], **claims: Any) -> str:
    ray, words = SimpleNamespace(nodes=lambda: nodes), io.StringIO()
    look_for_room(ray, config(**claims), Console(file=words))
    return words.getvalue()


def test_that_no_node_has_room_for_a_worker_is_said() -> None:
    assert told([SMALL], worker_cpus=2) == ""
    assert told([SMALL, LARGE], worker_cpus=4, worker_gpus=0.5) == ""
    assert "4 cores and 0 GPUs" in told([SMALL, GONE], worker_cpus=4)
    assert "1 cores and 2 GPUs" in told([SMALL, LARGE], worker_cpus=1, worker_gpus=2)


def test_workers_find_room_node_by_node() -> None:
    ray = SimpleNamespace(nodes=lambda: [SMALL, LARGE, GONE])
    assert num_workers(ray, config(worker_cpus=2)) == 1 + 4
    assert num_workers(ray, config(worker_cpus=0.5)) == 6 + 16
    assert num_workers(ray, config(worker_cpus=2, worker_gpus=0.5)) == 2
    assert num_workers(ray, config(worker_cpus=16)) == 0


@pytest.mark.parametrize("claims", [{"worker_cpus": 0}, {"worker_gpus": -1}])
def test_claims_are_numbers_that_can_be_had(claims: dict[str, float]) -> None:
    with pytest.raises(InvalidError, match=next(iter(claims))):
        config(**claims)


def test_what_ray_says_of_a_dead_worker_becomes_one_line() -> None:
    words = io.StringIO()
    with redirect_stdout(RayOutput(Console(file=words))):
        # The output of ray 2.60.
        sys.stdout.write(
            "\x1b[33m(raylet)\x1b[0m A worker died or was killed while executing a task by an "
            "unexpected system error. To troubleshoot the problem, check the logs for the dead "
            "worker. Lease ID: 00 Worker ID: a5 Node ID: 28 Worker IP address: 192.0.2.2 Worker "
            "port: 42515 Worker PID: 6361 Worker exit type: SYSTEM_ERROR Worker exit detail: "
            "Worker unexpectedly exits with a connection error code 2. Some common causes "
            "include: (1) the process was killed by the OOM killer due to high memory usage"
        )
        sys.stdout.write("Task do_task failed. There are 2 retries remaining. Error: \n")
        sys.stdout.write(
            "(raylet) Task do_task failed. There are 2 retries remaining, so the task will be "
            "retried. Error: User exception:\nray::do_task() (pid=6850, ip=192.0.2.2)\n"
            '  File "worker.py", line 8, in do\n    raise OSError("full")\nOSError: disc is full\n'
            "\nSystem error:\nIntentionalSystemExit: Worker exits with an exit code 0.\n"
        )
        sys.stdout.write("2 Workers (tasks / actors) killed due to memory pressure (OOM)\n")
    told = words.getvalue().splitlines()
    assert [line.partition(";")[0] for line in told] == [
        "worker process 6361 on node 192.0.2.2 was killed or crashed (out of memory, a signal, or "
        "native code)",
        "a task failed (OSError: disc is full)",
        "a node ran out of memory and ended a worker",
    ]
