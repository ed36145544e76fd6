"""A worker's task: the run, and the piece of it to train."""

from __future__ import annotations

from dataclasses import dataclass, replace
from enum import Enum

from trainer.fit.config import FitConfig
from trainer.run.config import TrainConfig

from .cut import Part

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
