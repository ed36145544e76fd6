"""Puts the pieces of a stream together, in order, as far as its index goes; shows the progress of
all workers, and pictures of what has joined.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace

from codec.errors import InvalidError
from codec.progressline import ProgressLine
from codec.storage.openstorage import open_growing
from codec.stream import StreamReader
from codec.stream.finishing import focus_of
from codec.stream.manifest import Manifest, object_name
from codec.stream.poster import write_poster, write_storyboard
from codec.stream.segment import SegmentRecord, parse_index, record_bytes
from codec.stream.writer import SHAPE
from player.render.cpu import render_splats
from trainer.pictures.framecache import FrameCache
from trainer.run.config import TrainConfig
from trainer.run.monitor import RunLog, RunStatus
from trainer.run.outputs import SOURCE, CaptureSound, write_snapshot
from trainer.run.prepare import Prepared

from .task import STATE_FOLDER, Run, Task
from .worker import MANIFEST_PATH, MAX_STATE_BYTES, unpack_arrays


class Joiner:
    """The one writer of the stream's index, which names a segment when all before it are there."""

    def __init__(self, run: Run, sound: CaptureSound | None = None) -> None:
        self._run, self._sound = run, sound
        self._files = open_growing(run.config.target, SHAPE)
        self._manifest: Manifest | None = None
        self._num_segments = 0
        self._waiting = sorted(run.tasks[1:], key=lambda task: task.frames.start)
        """The tasks whose segments are not in the index, in order; genesis has none."""

    def begin(self, resumed: bool) -> list[SegmentRecord]:
        """Makes the place a stream; genesis has been trained. resumed: it may be one already; gives
        the segments in its index. Raises InvalidError if that one's sound is not that of now."""
        made = Manifest.from_json(self._files.read(MANIFEST_PATH, MAX_STATE_BYTES))
        sources = () if self._sound is None else (SOURCE,)
        self._manifest = manifest = replace(made, sound=sources)
        if not resumed or not self._files.holds(SHAPE.head):
            self._files.begin(manifest.to_json(), others_began=True)
            return []
        reader = StreamReader(self._run.config.target, max_gaussians=None)
        if reader.manifest.sound != sources:
            found = "has no" if sources else "has"
            raise InvalidError(
                f"{reader.name} {found} sound, unlike the capture now; train into another folder"
            )
        self._num_segments = len(reader.records)
        size = record_bytes(manifest.num_layers)
        beyond = -(-self._run.parts[-1].end_frame // manifest.segment_frames)
        # Segments after the last in the index are there already, and stay.
        self._files.take_over(reader.index_bytes, size, beyond)
        shown = self._num_segments * manifest.segment_frames
        self._waiting = [task for task in self._waiting if task.frames.stop > shown]
        return list(reader.records)

    def go_on(self) -> Iterator[tuple[Task, list[SegmentRecord]]]:
        """Takes in what has been finished; gives each task whose segments are new in the index, and
        those."""
        assert self._manifest is not None
        while self._waiting and self._files.holds(self._waiting[0].last_path):
            task, manifest = self._waiting.pop(0), self._manifest
            rows = unpack_arrays(self._files.read(task.last_path, MAX_STATE_BYTES))["records"]
            first = self._num_segments
            # A driver that died may have named some.
            new = rows[first - task.frames.start // manifest.segment_frames :]
            for segment in range(first, first + len(new)):
                self._put_sound(segment)
            self._files.append(first * rows.shape[1], new.tobytes())
            self._num_segments += len(new)
            yield task, parse_index(new.tobytes(), manifest.num_layers, first)

    def _put_sound(self, segment: int) -> None:
        if self._sound is None:
            return
        assert self._manifest is not None
        begin = segment * self._manifest.segment_frames
        end = min(begin + self._manifest.segment_frames, self._run.parts[-1].end_frame)
        for name, data in self._sound.objects(begin, end).items():
            self._files.put(object_name(segment, name), data)

    def finish(self) -> Manifest:
        """Marks the stream as finished; all tasks are done."""
        assert self._manifest is not None
        assert not self._waiting
        focus = focus_of(StreamReader(self._run.config.target, max_gaussians=None))
        finished = replace(self._manifest, live=False, focus=focus)
        write_poster(self._run.config.target, render_splats)
        write_storyboard(self._run.config.target, render_splats)
        self._files.finish(finished.to_json())
        self._files.delete(STATE_FOLDER)
        return finished


class JoinMonitor:
    """Shows all iterations of all workers on a progress line, and logs every segment that has
    joined the stream."""

    def __init__(
        self,
        line: ProgressLine,
        log: RunLog,
        num_frames: int,
        now_s: Callable[[], float] = time.monotonic,
    ) -> None:
        self._line, self._log, self._num_frames, self._now_s = line, log, num_frames, now_s
        self._begin_s, self._total, self._done, self._before = now_s(), 1, 0, 0
        self._frames = self._scored_frames = 0
        self._played_bytes = 0
        self._psnr_sum_db = 0.0

    def begin(self, iterations: int) -> None:
        """All workers together have so many before them."""
        self._begin_s, self._total = self._now_s(), max(iterations, 1)

    def found(self, records: Sequence[SegmentRecord]) -> None:
        """These have joined the stream before."""
        for record in records:
            self._count(record)

    def progressed(self, iterations: int, before: int = 0) -> None:
        """All workers together have done so many, `before` of them in an earlier run."""
        self._done, self._before = iterations, before
        self._line.show(self._status().stage())

    def joined(self, records: Sequence[SegmentRecord]) -> None:
        """These have joined the stream now."""
        for record in records:
            self._count(record)
            status = self._status()
            self._log.add(status.log_row() | {"frame": self._frames - 1})
            self._line.show(status.stage())

    def _count(self, record: SegmentRecord) -> None:
        self._frames = record.first_frame + record.num_frames
        self._played_bytes += record.played_bytes
        if not math.isnan(record.psnr_db[-1]):
            self._scored_frames += record.num_frames
            self._psnr_sum_db += record.num_frames * record.psnr_db[-1]

    def _status(self) -> RunStatus:
        elapsed_s, frames = self._now_s() - self._begin_s, self._frames
        now_done = self._done - self._before
        left_s = elapsed_s / now_done * (self._total - self._done) if now_done else None
        scored = self._scored_frames
        return RunStatus(
            frame=frames,
            num_frames=self._num_frames,
            share=min(self._done / self._total, 1.0),
            elapsed_s=elapsed_s,
            left_s=left_s,
            psnr_db=self._psnr_sum_db / scored if scored else None,
            bytes_per_frame=self._played_bytes / frames if frames else None,
            iterations_per_s=now_done / elapsed_s if now_done else None,
        )


def draw_joined(config: TrainConfig, prepared: Prepared, records: Sequence[SegmentRecord]) -> None:
    """Draws every so many frames of the segments that have joined the stream now, beside the
    capture's."""
    every = config.snapshot_every
    frames = [n for r in records for n in range(r.first_frame, r.first_frame + r.num_frames)]
    due = [frame for frame in frames if every and frame % every == 0]
    if not due:
        return
    reader = StreamReader(config.target, max_gaussians=None)
    # Pictures of other frames need not be held for these.
    with FrameCache(prepared.capture, prepared.frames, prepared.scale, config.cache_bytes) as cache:
        for frame in due:
            splats = reader.active_splats(frame, reader.manifest.num_layers)
            write_snapshot(splats, frame, cache, prepared.near_planes, config.work_folder)
