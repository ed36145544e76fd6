"""Parts cover a capture in whole segments, and tasks come in the order in which the stream grows
soonest."""

from __future__ import annotations

from collections import deque
from dataclasses import replace
from itertools import pairwise

import pytest
from hypothesis import given
from hypothesis import strategies as st

from codec.errors import InvalidError
from trainer.parts.cut import cut
from trainer.parts.task import Kind, Run, Task
from trainer.parts.taskqueue import TaskQueue
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
def test_every_task_is_handed_out_once_and_after_what_it_needs(
    num_parts: int, at_a_time: int, data: st.DataObject
) -> None:
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
