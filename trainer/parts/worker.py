"""What a worker does: trains a piece of a stream from what others left, and leaves what they need.

Rule: everything that is left is put whole, and a task that is done again, from its last checkpoint
or from its beginning, leaves the same bytes. So a worker may die at any moment.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from codec.slots.update import Update
from codec.splats import Splats
from codec.storage.growingpiece import GrowingPiece
from codec.storage.openfiles import Files, open_files
from codec.stream.manifest import MAX_MANIFEST_BYTES, Manifest
from codec.stream.writer import SHAPE, StreamWriter
from trainer.fit.config import FitConfig
from trainer.fit.trainer import Observer, Progress, Trainer, Window
from trainer.lease.takeover import Held, Takeover
from trainer.pictures.feed import CapturePictures
from trainer.pictures.framecache import FrameCache
from trainer.run.prepare import Prepared, first_gaussians, make_manifest, prepare
from trainer.score.meter import QualityMeter

from .leftovers import (
    MANIFEST_PATH,
    MAX_STATE_BYTES,
    Arrays,
    below,
    held_in,
    pack_arrays,
    standing,
    under,
    unpack_arrays,
)
from .task import Kind, Task

Tell = Callable[[int], None]
"""Is told how many iterations have been done."""


class _Teller(Observer):
    """Passes on how many iterations have been done since the last word."""

    def __init__(self, tell: Tell) -> None:
        self._tell = tell
        self._done = 0

    def window_begun(self, first_frame: int) -> None:
        self._done = 0

    def progressed(self, progress: Progress) -> None:
        self._tell(progress.iteration - self._done)
        self._done = progress.iteration


@dataclass(frozen=True, slots=True)
class _Piece:
    """Segments in the making."""

    place: GrowingPiece
    writer: StreamWriter

    @property
    def record_rows(self) -> npt.NDArray[np.uint8]:
        """(N, bytes of a record) uint8."""
        rows = np.frombuffer(b"".join(self.place.records), np.uint8)
        return rows.reshape(len(self.place.records), -1)

    def append(self, updates: Sequence[Update]) -> None:
        for update in updates:
            self.writer.append(update)


@dataclass(frozen=True, slots=True)
class Worker:
    """A worker that has opened the capture."""

    task: Task
    prepared: Prepared
    cache: FrameCache
    pictures: CapturePictures
    files: Files
    tell: Tell

    def work(self) -> None:
        """Does the task."""
        match self.task.kind:
            case Kind.GENESIS:
                self._train_genesis()
            case Kind.PART:
                self._train_part()
            case Kind.SEAM:
                self._train_seam()

    def _resumed(self, manifest: Manifest, arrays: Arrays, fit: FitConfig | None = None) -> Trainer:
        """One who goes on from what `standing` gave, with the run's settings or `fit`."""
        trainer = self._trainer(manifest, None, fit)
        trainer.restore(below("state", arrays))
        return trainer

    def _trainer(
        self, manifest: Manifest, initial: Splats | None, fit: FitConfig | None = None
    ) -> Trainer:
        prepared = self.prepared
        return Trainer(
            fit or self.task.run.config.fit, self.pictures, initial, prepared.near_m,
            prepared.far_m, prepared.picked.backend, (_Teller(self.tell),), manifest.slot_layout,
            prepared.search_from_m,
        )  # fmt: skip

    def _train_genesis(self) -> None:
        config = self.task.run.config
        initial = first_gaussians(config, self.prepared, self.pictures)
        manifest = make_manifest(config, self.prepared, self.cache, initial)
        trainer = self._trainer(manifest, initial)
        (held,) = trainer.held(next(trainer.windows()))
        self.files.put(MANIFEST_PATH, manifest.to_json())
        self._leave("state", standing(trainer, held))  # last: who finds it finds both

    def _train_part(self) -> None:
        task, part, manifest = self.task, self.task.part, self._manifest()
        if self.files.holds(task.state_path("checkpoint")):
            arrays = self._left(task, "checkpoint")
            trainer = self._resumed(manifest, arrays)
            piece = self._piece(manifest, trainer.next_window, held_in(arrays))
            piece.place.records += [record.tobytes() for record in arrays["records"]]
        elif part.number:
            trainer, piece = self._approach(manifest)
        else:
            arrays = self._left(task.other(Kind.GENESIS), "state")
            trainer, piece = self._resumed(manifest, arrays), self._piece(manifest, 0, None)
            piece.writer.append(held_in(arrays).as_opening())
        for window in self._windows(trainer, part.end_frame):
            frame = window.first_frame
            piece.append(window.updates)
            trainer.spent(window, piece.writer.slice_bytes)
            if (frame + 1) % manifest.segment_frames == 0 and frame + 1 < part.end_frame:
                (held,) = trainer.held(window)
                records = {"records": piece.record_rows}
                self._leave("checkpoint", standing(trainer, held) | records)
        (held,) = trainer.held(window)
        piece.writer.close()  # the last segment of a stream may be short
        self._leave("end", standing(trainer, held))
        self._leave("records", {"records": piece.record_rows})

    def _approach(self, manifest: Manifest) -> tuple[Trainer, _Piece]:
        """Learns what has changed since genesis, and leaves what the part holds in the frames of
        the seam at its beginning; gives who goes on behind them, and the piece that begins there.
        """
        task, part, run = self.task, self.task.part, self.task.run
        trainer = self._resumed(manifest, self._left(task.other(Kind.GENESIS), "state"))
        trainer.jump(max(1, part.first_frame - run.config.warm_frames))
        for _ in self._windows(trainer, part.first_frame):
            pass
        trainer, begin = self._other(trainer, manifest, run.seam_fit), task.frames.start
        approach: Arrays = {}
        held = None
        for window in self._windows(trainer, begin):
            (held,) = trainer.held(window)
            approach |= under(held.birth, held.to_arrays())
        self._leave("approach", approach)
        piece = self._piece(manifest, begin, held)
        return self._other(trainer, manifest, run.config.fit), piece

    def _other(self, trainer: Trainer, manifest: Manifest, fit: FitConfig) -> Trainer:
        """One who goes on from where `trainer` stands, with other settings."""
        other = self._trainer(manifest, None, fit)
        other.restore(trainer.state())
        return other

    def _train_seam(self) -> None:
        task, part, run = self.task, self.task.part, self.task.run
        manifest, config = self._manifest(), run.config
        before = self._left(task.other(Kind.PART, part.number - 1), "end")
        arrays = self._left(task.other(Kind.PART, part.number), "approach")
        births = task.frames
        other = {birth: Held.from_arrays(below(birth, arrays)) for birth in births}
        trainer = self._resumed(manifest, before, run.seam_fit)
        trainer.take_over(Takeover(other, config.fit.swin_size, config.fit.seed))
        piece = self._piece(manifest, births.start, held_in(before))
        for window in self._windows(trainer, births.stop):
            piece.append(window.updates)
        self._leave("records", {"records": piece.record_rows})

    def _windows(self, trainer: Trainer, end_frame: int) -> Iterator[Window]:
        """Those before `end_frame`."""
        if trainer.next_window >= end_frame:
            return
        for window in trainer.windows():
            self.pictures.prefetch(window.first_frame + 2, window.first_frame)
            yield window
            if window.first_frame + 1 == end_frame:
                return

    def _piece(self, manifest: Manifest, frame: int, opening: Held | None) -> _Piece:
        """A piece of the stream from `frame` on, before which a player holds `opening`."""
        place = GrowingPiece(self.files, SHAPE)
        quality = QualityMeter(self.cache, manifest)
        updates = () if opening is None else (opening.as_opening(),)
        segment = frame // manifest.segment_frames
        return _Piece(place, StreamWriter.piece(place, manifest, segment, updates, quality))

    def _manifest(self) -> Manifest:
        return Manifest.from_json(self.files.read(MANIFEST_PATH, MAX_MANIFEST_BYTES))

    def _leave(self, what: str, arrays: Arrays) -> None:
        self.files.put(self.task.state_path(what), pack_arrays(arrays))

    def _left(self, task: Task, what: str) -> Arrays:
        return unpack_arrays(self.files.read(task.state_path(what), MAX_STATE_BYTES))


@contextmanager
def opened_worker(task: Task, tell: Tell) -> Iterator[Worker]:
    """A worker for `task`. Raises SwingsError where capture or settings cannot work."""
    config = task.run.config
    prepared = prepare(config)
    with FrameCache(prepared.capture, prepared.frames, config.scale, config.cache_bytes) as cache:
        pictures = CapturePictures(cache, prepared.capture.training)
        yield Worker(task, prepared, cache, pictures, open_files(config.target), tell)
