"""Which task is given away next."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from .task import Run, Task


class TaskQueue:
    """Hands tasks out in the order of the stream, each once what it needs has been done: so the
    stream grows from its beginning, and little waits to be joined."""

    def __init__(self, run: Run, is_done: Callable[[Task], bool]) -> None:
        """is_done: whether a task has been done before."""
        self._done = {task.name for task in run.tasks if is_done(task)}
        self._waiting = [task for task in run.tasks if task.name not in self._done]

    @property
    def waiting(self) -> Sequence[Task]:
        """Tasks that have not been handed out."""
        return self._waiting

    def is_done(self, task: Task) -> bool:
        return task.name in self._done

    def take(self) -> Task | None:
        """The first that can be done now; None where all that are left need others first."""
        for index, task in enumerate(self._waiting):
            if all(map(self.is_done, task.needs)):
                return self._waiting.pop(index)
        return None

    def done(self, task: Task) -> None:
        """One that was handed out has been done."""
        self._done.add(task.name)
