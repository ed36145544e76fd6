"""A worker's task: it trains a piece of a stream from the results of others, and leaves in storage,
as bytes, the state that those after it need.

Rule: everything that is left is put whole, and a task that is done again, from its last checkpoint
or from its beginning, leaves the same bytes. So a worker may die at any moment.
"""

from __future__ import annotations

import io
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import partial
from typing import Any

import numpy as np
import numpy.typing as npt

from codec.arrays import Bytes
from codec.slots.slotlayout import Update
from codec.splats import Splats
from codec.storage.openstorage import open_growing
from codec.storage.storage import GrowingPiece, GrowingPlace
from codec.stream.manifest import MANIFEST_NAME, MAX_MANIFEST_BYTES, Manifest
from codec.stream.writer import SHAPE, StreamWriter
from trainer.fit.config import FitConfig
from trainer.fit.leasedslots import LeasedSlots
from trainer.fit.observer import Observer, Progress, Window
from trainer.fit.trainer import Trainer
from trainer.lease.takeover import Crossfade, PlayerState
from trainer.pictures.framecache import CapturePictures, FrameCache
from trainer.run.checkpoint import KEEP_S, GenesisKeeper, KeepTimer, arrays_of, update_of
from trainer.run.prepare import Prepared, first_gaussians, make_manifest, prepare
from trainer.score.meter import QualityMeter

from .task import STATE_FOLDER, Kind, Task

Arrays = dict[str, npt.NDArray[Any]]

MAX_STATE_BYTES = 1 << 34
"""Largest accepted file: tens of millions of Gaussians."""

MANIFEST_PATH = f"{STATE_FOLDER}/{MANIFEST_NAME}"
"""The stream's manifest as genesis leaves it."""


def pack_arrays(arrays: Arrays) -> bytes:
    """The opposite of `unpack_arrays`. The same arrays give the same bytes."""
    file = io.BytesIO()
    np.savez(file, **arrays)  # type: ignore[arg-type]  # its stub takes the names for options
    return file.getvalue()


def unpack_arrays(data: bytes) -> Arrays:
    with np.load(io.BytesIO(data), allow_pickle=False) as file:
        return {name: file[name] for name in file.files}


def with_prefix(name: str | int, arrays: Arrays) -> Arrays:
    """`arrays` with the prefix `name` on each key."""
    return {f"{name}.{key}": array for key, array in arrays.items()}


def without_prefix(name: str | int, arrays: Arrays) -> Arrays:
    """The arrays whose keys have the prefix `name`, without it; the opposite of `with_prefix`."""
    start = f"{name}."
    return {k.removeprefix(start): v for k, v in arrays.items() if k.startswith(start)}


def part_state(trainer: Trainer, held: PlayerState) -> Arrays:
    """The state of a trainer, and that of a player which has received all its slices."""
    return {**with_prefix("state", trainer.state()), **with_prefix("held", held.to_arrays())}


def player_state_in(arrays: Arrays) -> PlayerState:
    """The player's state in the arrays of `part_state`."""
    return PlayerState.from_arrays(without_prefix("held", arrays))


Report = Callable[[int], None]
"""Gets the number of iterations of the task that are done, by this process or one before it."""


class _Reporter(Observer):
    """Counts the iterations of a task."""

    def __init__(self, report: Report) -> None:
        self._report = report
        self._of_window = 0
        self.done = 0

    def begin(self, done: int) -> None:
        """So many iterations of the task were done before."""
        self.done = done
        self._report(done)

    def window_begun(self, first_frame: int, done: int) -> None:
        self._of_window = done

    def progressed(self, progress: Progress) -> None:
        self.done += progress.iteration - self._of_window
        self._of_window = progress.iteration
        self._report(self.done)


@dataclass(slots=True)
class _Piece:
    """Segments in the making."""

    place: GrowingPiece
    writer: StreamWriter
    opening: PlayerState | None
    """A player's slots before the newest segment; None before the stream."""
    updates: list[Update] = field(default_factory=list)
    """Updates of the newest segment, until it is whole."""

    @property
    def record_rows(self) -> Bytes:
        """(N, bytes of a record) uint8."""
        rows = np.frombuffer(b"".join(self.place.records), np.uint8)
        return rows.reshape(len(self.place.records), -1)

    def append(self, updates: Sequence[Update]) -> None:
        for update in updates:
            self.writer.append(update)
            self.updates.append(update)

    def close_segment(self, held: PlayerState) -> None:
        """The newest segment is whole; a player holds `held` after it."""
        self.opening = held
        self.updates.clear()

    def to_arrays(self) -> Arrays:
        """All that a new piece needs to go on."""
        arrays: Arrays = {"births": np.array([update.birth for update in self.updates], np.int64)}
        if self.place.records:
            arrays["records"] = self.record_rows
        if self.opening is not None:
            arrays |= with_prefix("opening", self.opening.to_arrays())
        for update in self.updates:
            arrays |= with_prefix(update.birth, arrays_of(update))
        return arrays


@dataclass(frozen=True, slots=True)
class Worker:
    """A worker that has opened the capture."""

    task: Task
    prepared: Prepared
    cache: FrameCache
    pictures: CapturePictures
    files: GrowingPlace
    reporter: _Reporter
    timer: KeepTimer

    def work(self) -> None:
        """Does the task."""
        match self.task.kind:
            case Kind.GENESIS:
                self._train_genesis()
            case Kind.PART:
                self._train_part()
            case Kind.SEAM:
                self._train_seam()

    def _trainer(
        self,
        manifest: Manifest,
        start: Splats | Arrays,
        fit: FitConfig | None = None,
        takeover: Crossfade | None = None,
    ) -> Trainer:
        """A trainer with the run's settings or `fit`. start: its first Gaussians, or what
        `part_state` or `_keep` gave. takeover: another training that its slots come to follow."""
        prepared = self.prepared
        leased = partial(LeasedSlots, layout=manifest.slot_layout, takeover=takeover)
        keeper = GenesisKeeper(lambda: self._keep(trainer), self.timer)
        trainer = Trainer(
            fit or self.task.run.config.fit, self.pictures,
            start if isinstance(start, Splats) else None, prepared.training_planes,
            prepared.far_m, prepared.picked.backend, (self.reporter, keeper), leased,
            prepared.search_from_m,
        )  # fmt: skip
        if not isinstance(start, Splats):
            trainer.restore(without_prefix("state", start))
        return trainer

    def _keep(self, trainer: Trainer, piece: _Piece | None = None) -> None:
        """Leaves a checkpoint."""
        arrays = with_prefix("state", trainer.state())
        arrays["iterations"] = np.array(self.reporter.done)
        if piece is not None:
            arrays |= with_prefix("piece", piece.to_arrays())
        self._leave("checkpoint", arrays)

    def _kept(self) -> Arrays | None:
        """The last checkpoint of this task, None if it has to begin. Call it first."""
        if not self.files.holds(self.task.state_path("checkpoint")):
            self.reporter.begin(0)
            return None
        arrays = self._left(self.task, "checkpoint")
        self.reporter.begin(int(arrays["iterations"]))
        return arrays

    def _train_genesis(self) -> None:
        config, kept = self.task.run.config, self._kept()
        if kept is None:
            initial = first_gaussians(config, self.prepared, self.pictures)
            manifest = make_manifest(config, self.prepared, self.cache, initial)
            self.files.put(MANIFEST_PATH, manifest.to_json())
            trainer = self._trainer(manifest, initial)
        else:
            trainer = self._trainer(self._manifest(), kept)
        (held,) = trainer.strategy.held(next(trainer.windows()))
        self._leave("state", part_state(trainer, held))

    def _train_part(self) -> None:
        task, part, manifest = self.task, self.task.part, self._manifest()
        kept, begin = self._kept(), task.frames.start
        if kept is None:
            genesis = self._left(task.other(Kind.GENESIS), "state")
            trainer = self._trainer(manifest, genesis)
            if part.number:
                trainer.jump(max(1, part.first_frame - task.run.config.warm_frames))
        else:
            trainer = self._trainer(manifest, kept)
        if trainer.next_window < begin:
            trainer = self._approach(trainer, manifest)
        if kept is not None and (of_piece := without_prefix("piece", kept)):
            piece = self._resumed_piece(manifest, trainer.next_window, of_piece)
        elif part.number:
            before = self._left(task, f"approach-{begin - 1}")
            piece = self._piece(manifest, begin, PlayerState.from_arrays(before))
        else:
            piece = self._piece(manifest, 0, None)
            piece.append([player_state_in(genesis).as_opening()])
        held = self._train_piece(trainer, piece, part.end_frame)
        piece.writer.close()  # the last segment of a stream may be short
        self._leave("end", part_state(trainer, held))
        self._leave("records", {"records": piece.record_rows})

    def _approach(self, trainer: Trainer, manifest: Manifest) -> Trainer:
        """Learns what has changed since genesis, and leaves what the part holds in the frames of
        the seam at its beginning; gives the trainer of the frames after them."""
        task, part, run = self.task, self.task.part, self.task.run
        for _ in self._windows(trainer, part.first_frame):
            self.timer.keep_if_due(partial(self._keep, trainer))
        trainer = self._trainer(manifest, with_prefix("state", trainer.state()), run.seam_fit)
        for window in self._windows(trainer, task.frames.start):
            (held,) = trainer.strategy.held(window)
            self._leave(f"approach-{held.birth}", held.to_arrays())
            self.timer.keep_if_due(partial(self._keep, trainer))
        return self._trainer(manifest, with_prefix("state", trainer.state()))

    def _train_seam(self) -> None:
        task, part, run = self.task, self.task.part, self.task.run
        manifest, config, kept = self._manifest(), run.config, self._kept()
        approach = task.other(Kind.PART, part.number)
        other = {
            birth: PlayerState.from_arrays(self._left(approach, f"approach-{birth}"))
            for birth in task.frames
        }
        before = kept or self._left(task.other(Kind.PART, part.number - 1), "end")
        takeover = Crossfade(other, config.fit.swin_size, config.fit.seed)
        trainer = self._trainer(manifest, before, run.seam_fit, takeover)
        if kept is None:
            piece = self._piece(manifest, task.frames.start, player_state_in(before))
        else:
            piece = self._resumed_piece(
                manifest, trainer.next_window, without_prefix("piece", kept)
            )
        self._train_piece(trainer, piece, task.frames.stop)
        self._leave("records", {"records": piece.record_rows})

    def _train_piece(self, trainer: Trainer, piece: _Piece, end_frame: int) -> PlayerState:
        """Trains the windows before `end_frame` into `piece`; gives what a player holds then."""
        for window in self._windows(trainer, end_frame):
            piece.append(window.updates)
            if self.task.kind is Kind.PART:
                trainer.strategy.record_sent_bytes(window, piece.writer.slice_bytes)
            (held,) = trainer.strategy.held(window)
            if trainer.next_window % piece.writer.manifest.segment_frames == 0:
                piece.close_segment(held)
            if trainer.next_window < end_frame:
                self.timer.keep_if_due(partial(self._keep, trainer, piece))
        return held

    def _windows(self, trainer: Trainer, end_frame: int) -> Iterator[Window]:
        """The windows before `end_frame`."""
        if trainer.next_window >= end_frame:
            return
        for window in trainer.windows():
            self.pictures.prefetch(window.first_frame + 2, window.first_frame)
            yield window
            if window.first_frame + 1 == end_frame:
                return

    def _piece(self, manifest: Manifest, frame: int, opening: PlayerState | None) -> _Piece:
        """A piece of the stream from `frame` on, before which a player holds `opening`."""
        place = GrowingPiece(self.files, SHAPE)
        quality = QualityMeter(self.cache, manifest)
        updates = () if opening is None else (opening.as_opening(),)
        segment = frame // manifest.segment_frames
        writer = StreamWriter.piece(place, manifest, segment, updates, quality)
        return _Piece(place, writer, opening)

    def _resumed_piece(self, manifest: Manifest, frame: int, arrays: Arrays) -> _Piece:
        """A piece that goes on with `frame` from what `_Piece.to_arrays` gave."""
        of_opening, births = without_prefix("opening", arrays), arrays["births"]
        opening = PlayerState.from_arrays(of_opening) if of_opening else None
        piece = self._piece(manifest, frame - len(births), opening)
        piece.place.records += [record.tobytes() for record in arrays.get("records", ())]
        piece.append([update_of(int(birth), without_prefix(birth, arrays)) for birth in births])
        return piece

    def _manifest(self) -> Manifest:
        return Manifest.from_json(self.files.read(MANIFEST_PATH, MAX_MANIFEST_BYTES))

    def _leave(self, what: str, arrays: Arrays) -> None:
        self.files.put(self.task.state_path(what), pack_arrays(arrays))

    def _left(self, task: Task, what: str) -> Arrays:
        return unpack_arrays(self.files.read(task.state_path(what), MAX_STATE_BYTES))


@contextmanager
def opened_worker(task: Task, report: Report, keep_s: float = KEEP_S) -> Iterator[Worker]:
    """A worker for `task`, with a checkpoint about every `keep_s` seconds. Raises SwingsError where
    capture or settings cannot work."""
    config = task.run.config
    prepared = prepare(config)
    with FrameCache(prepared.capture, prepared.frames, prepared.scale, config.cache_bytes) as cache:
        pictures = CapturePictures(cache, prepared.capture.training)
        files, timer = open_growing(config.target, SHAPE), KeepTimer(keep_s)
        yield Worker(task, prepared, cache, pictures, files, _Reporter(report), timer)
