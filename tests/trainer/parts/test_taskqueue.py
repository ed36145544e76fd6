"""Parts in whole segments, tasks in the order of the stream, and checks of a cluster."""

from __future__ import annotations

import io
import sys
from collections import deque
from contextlib import redirect_stdout
from dataclasses import replace
from itertools import pairwise
from types import SimpleNamespace

import pytest
from hypothesis import given
from hypothesis import strategies as st
from rich.console import Console

from codec.errors import InvalidError
from trainer.parts.raydriver import RayOutput, look_for_room, num_workers
from trainer.parts.task import Kind, Run, Task, TaskQueue, cut
from trainer.run.config import TrainConfig


@given(st.integers(1, 2000), st.integers(2, 400), st.integers(1, 30), st.integers(1, 3))
def test_parts_follow_each_other_in_whole_segments_longer_than_a_seam(
    num_frames: int, part_frames: int, segment_frames: int, seam_segments: int
) -> None:
    seam_frames = seam_segments * segment_frames
    if part_frames <= seam_frames:
        with pytest.raises(InvalidError, match="more than"):
            cut(num_frames, part_frames, segment_frames, seam_frames)
        return
    parts = cut(num_frames, part_frames, segment_frames, seam_frames)
    assert [part.number for part in parts] == list(range(len(parts)))
    assert parts[0].first_frame == 0
    assert parts[-1].end_frame == num_frames
    for one, other in pairwise(parts):
        assert one.end_frame == other.first_frame
        assert one.end_frame % segment_frames == 0
    for part in parts[1:]:
        assert part.end_frame - part.first_frame > seam_frames
    longest = max(part.end_frame - part.first_frame for part in parts)
    assert longest < part_frames + segment_frames + seam_frames


def run_of(num_parts: int) -> Run:
    config = replace(TrainConfig("capture", "stream"), segment_frames=2, seam_frames=2)
    return Run(config, tuple(cut(6 * num_parts, 6, 2, 2)))


@given(st.integers(1, 9), st.integers(1, 6), st.data())
def test_tasks_come_once_and_in_order(num_parts: int, at_a_time: int, data: st.DataObject) -> None:
    run = run_of(num_parts)
    tasks = run.tasks
    # What an earlier run has done includes what that needs.
    before = {t.name for t in tasks[: data.draw(st.integers(0, len(tasks)))]}
    queue = TaskQueue(run, lambda task: task.name in before)
    finished, working = set(before), list[Task]()
    while True:
        while len(working) < at_a_time and (task := queue.take()) is not None:
            assert task.name not in finished
            assert {other.name for other in task.needs} <= finished
            working.append(task)
        if not working:
            break
        task = working.pop(data.draw(st.integers(0, len(working) - 1)))
        finished.add(task.name)
        queue.done(task)
    assert not queue.waiting
    assert finished == {task.name for task in tasks}


@given(st.integers(2, 40), st.integers(1, 8))
def test_few_parts_wait_for_their_seams(num_parts: int, at_a_time: int) -> None:
    """What parts leave for their seams is bounded by the workers, not by the length."""
    queue = TaskQueue(run_of(num_parts), lambda task: False)
    working: deque[Task] = deque()
    waiting: set[int] = set()  # unfinished seams with a finished part
    while True:
        while len(working) < at_a_time and (task := queue.take()) is not None:
            working.append(task)
        if not working:
            break
        task = working.popleft()
        queue.done(task)
        if task.kind is Kind.PART:
            waiting |= {n for n in (task.number, task.number + 1) if 0 < n < num_parts}
        elif task.kind is Kind.SEAM:
            waiting.remove(task.number)
        assert len(waiting) <= 2 * at_a_time + 1
    assert not waiting


def test_iterations_are_those_of_the_windows() -> None:
    run = run_of(3)
    genesis, first, second, seam, *_ = run.tasks
    fit = run.config.fit
    assert genesis.iterations == fit.iterations(0)
    assert first.iterations == 5 * fit.window_iterations  # genesis has trained its first frame
    assert second.iterations == (4 + 5) * fit.window_iterations + 2 * run.seam_fit.window_iterations
    assert seam.iterations == 2 * run.seam_fit.window_iterations


SMALL = {"Alive": True, "Resources": {"CPU": 3.0}}
LARGE = {"Alive": True, "Resources": {"CPU": 8.0, "GPU": 1.0}}
GONE = {"Alive": False, "Resources": {"CPU": 64.0, "GPU": 8.0}}


def test_workers_find_room_node_by_node_and_where_there_is_none_it_is_said() -> None:
    for nodes, claims, number, said in (
        ([SMALL, LARGE, GONE], {"worker_cpus": 2}, 1 + 4, ""),
        ([SMALL, LARGE, GONE], {"worker_cpus": 0.5}, 6 + 16, ""),
        ([SMALL, LARGE, GONE], {"worker_cpus": 2, "worker_gpus": 0.5}, 2, ""),
        ([SMALL, GONE], {"worker_cpus": 4}, 0, "4 cores and 0 GPUs"),
        ([SMALL, LARGE], {"worker_cpus": 1, "worker_gpus": 2}, 0, "1 cores and 2 GPUs"),
    ):
        ray, words = SimpleNamespace(nodes=lambda nodes=nodes: nodes), io.StringIO()
        config = TrainConfig("capture", "stream", **claims)
        assert num_workers(ray, config) == number
        look_for_room(ray, config, Console(file=words))
        assert said in words.getvalue()
        assert bool(said) == bool(words.getvalue())


def test_what_ray_says_of_a_dead_worker_becomes_one_line() -> None:
    words = io.StringIO()
    with redirect_stdout(RayOutput(Console(file=words))):
        # The output of ray 2.60.
        sys.stdout.write(
            "\x1b[33m(raylet)\x1b[0m A worker died or was killed while executing a task by an "
            "unexpected system error. Lease ID: 00 Worker ID: a5 Node ID: 28 Worker IP address: "
            "192.0.2.2 Worker port: 42515 Worker PID: 6361 Worker exit type: SYSTEM_ERROR Worker "
            "exit detail: Worker unexpectedly exits with a connection error code 2."
        )
        sys.stdout.write("Task do_task failed. There are 2 retries remaining. Error: \n")
        sys.stdout.write(
            "(raylet) Task do_task failed. There are 2 retries remaining, so the task will be "
            "retried. Error: User exception:\nray::do_task() (pid=6850, ip=192.0.2.2)\n"
            '  File "worker.py", line 8, in do\n    raise OSError("full")\nOSError: disc is full\n'
            "\nSystem error:\nIntentionalSystemExit: Worker exits with an exit code 0.\n"
        )
        sys.stdout.write("2 Workers (tasks / actors) killed due to memory pressure (OOM)\n")
    told = [line.partition(";")[0] for line in words.getvalue().splitlines()]
    assert told[0].startswith("worker process 6361 on node 192.0.2.2 was killed or crashed (out of")
    assert told[1:] == [
        "a task failed (OSError: disc is full)",
        "a node ran out of memory and ended a worker",
    ]
