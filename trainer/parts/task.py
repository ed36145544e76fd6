"""Where a capture is cut into parts, what a worker's task is, and which task is given away next."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from enum import Enum

from codec.errors import InvalidError
from trainer.fit.config import FitConfig
from trainer.run.config import TrainConfig


@dataclass(frozen=True, slots=True)
class Part:
    """Frames that one worker trains, whole segments but for the last."""

    number: int
    first_frame: int
    end_frame: int


def cut(num_frames: int, part_frames: int, segment_frames: int, seam_frames: int) -> list[Part]:
    """The parts of a stream, of about `part_frames` each.

    Each has more frames than the seam at its beginning, so the last one may be longer. Raises
    InvalidError where parts would be shorter than that.
    """
    if part_frames <= seam_frames:
        raise InvalidError(
            f"part_frames {part_frames}: choose more than the {seam_frames} frames of a seam"
        )
    whole = -(-part_frames // segment_frames) * segment_frames
    firsts = list(range(0, num_frames, whole))
    if len(firsts) > 1 and num_frames - firsts[-1] <= seam_frames:
        firsts.pop()
    ends = [*firsts[1:], num_frames]
    return [Part(n, first, end) for n, (first, end) in enumerate(zip(firsts, ends, strict=True))]


STATE_FOLDER = ".parts"
"""Folder inside the stream, until it is finished, with the files that workers leave for others."""


ACTIVE_IN_SEAM = 0.5
"""Factor on the share of active slots in a seam, on both sides of it: the slots that go over move
already."""

ITERATIONS_IN_SEAM = 2.0
"""Factor on the iterations of a window in a seam: slots that go over are new to the part that keeps
training the others."""


def whole_segments(frames: int, segment_frames: int) -> int:
    """The frames of the segments that `frames` begin."""
    return -(-frames // segment_frames) * segment_frames


class Kind(Enum):
    """The kinds of pieces that are trained."""

    GENESIS = "genesis"
    """The first window, with which all parts begin."""
    PART = "part"
    """A part without the seam at its beginning."""
    SEAM = "seam"
    """The seam between a part and the one before."""


@dataclass(frozen=True, slots=True)
class Run:
    """A training run in parts."""

    config: TrainConfig
    parts: tuple[Part, ...]

    @property
    def seam_frames(self) -> int:
        """Frames in which a part takes over from the one before: whole segments."""
        return whole_segments(self.config.seam_frames, self.config.segment_frames)

    @property
    def tasks(self) -> list[Task]:
        """All tasks, in an order in which they can be done."""
        tasks = [Task(self, Kind.GENESIS)]
        for part in self.parts:
            tasks.append(Task(self, Kind.PART, part.number))
            if part.number:
                tasks.append(Task(self, Kind.SEAM, part.number))
        return tasks

    def seam_end(self, part: Part) -> int:
        """The first frame behind the seam at a part's beginning; the first part has none."""
        return part.first_frame + (self.seam_frames if part.number else 0)

    @property
    def seam_fit(self) -> FitConfig:
        """How the frames of a seam are trained, by the part that begins with them and by the one
        before."""
        fit = self.config.fit
        lease = replace(fit.lease, active_share=ACTIVE_IN_SEAM * fit.lease.active_share)
        iterations = round(ITERATIONS_IN_SEAM * fit.window_iterations)
        return replace(fit, lease=lease, window_iterations=iterations)


@dataclass(frozen=True, slots=True)
class Task:
    """One piece of work for a worker. Doing it again gives the same bytes."""

    run: Run
    kind: Kind
    number: int = 0
    """Number of the part."""

    @property
    def part(self) -> Part:
        return self.run.parts[self.number]

    @property
    def name(self) -> str:
        return self.kind.value if self.kind is Kind.GENESIS else f"{self.kind.value}-{self.number}"

    def state_path(self, what: str) -> str:
        """Where in the stream's place the task keeps something."""
        return f"{STATE_FOLDER}/{self.name}.{what}"

    @property
    def last_path(self) -> str:
        """Path of the last file that the task writes: once it exists, the task is done."""
        return self.state_path("state" if self.kind is Kind.GENESIS else "records")

    @property
    def frames(self) -> range:
        """Frames of the segments that the task leaves."""
        run, part = self.run, self.part
        match self.kind:
            case Kind.GENESIS:
                return range(0)
            case Kind.PART:
                return range(run.seam_end(part), part.end_frame)
            case Kind.SEAM:
                return range(part.first_frame, run.seam_end(part))

    @property
    def needs(self) -> tuple[Task, ...]:
        """The tasks that must be done before."""
        match self.kind:
            case Kind.GENESIS:
                return ()
            case Kind.PART:
                return (self.other(Kind.GENESIS),)
            case Kind.SEAM:
                return self.other(Kind.PART, self.number - 1), self.other(Kind.PART, self.number)

    @property
    def iterations(self) -> int:
        """How many it takes."""
        run, first = self.run, self.part.first_frame
        usual, in_seam = run.config.fit.iterations(1), run.seam_fit.iterations(1)
        match self.kind:
            case Kind.GENESIS:
                return run.config.fit.iterations(0)
            case Kind.PART:
                # The first part goes on from genesis, which has trained its first window.
                warm = min(run.config.warm_frames, first - 1) if first else -1
                return (len(self.frames) + warm) * usual + (self.frames.start - first) * in_seam
            case Kind.SEAM:
                return len(self.frames) * in_seam

    def other(self, kind: Kind, number: int = 0) -> Task:
        """Another task of the same run."""
        return Task(self.run, kind, number)


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
