"""Puts the pieces of a stream together: their index, in order, as far as it goes."""

from __future__ import annotations

from collections.abc import Iterator

from codec.storage.openstorage import open_growing
from codec.stream import StreamReader
from codec.stream.index import SegmentRecord, parse_index, record_bytes
from codec.stream.manifest import Manifest
from codec.stream.poster import write_poster
from codec.stream.storyboard import write_storyboard
from codec.stream.writer import SHAPE
from player.render.cpu import render_splats

from .part_state import MANIFEST_PATH, MAX_STATE_BYTES, unpack_arrays
from .task import STATE_FOLDER, Kind, Run, Task


class Joiner:
    """The one writer of the stream's index, which names a segment when all before it are there."""

    def __init__(self, run: Run) -> None:
        self._run = run
        self._files = open_growing(run.config.target, SHAPE)
        self._manifest: Manifest | None = None
        self._num_segments = 0
        self._waiting = [
            Task(run, kind, part.number)
            for part in run.parts
            for kind in ((Kind.SEAM, Kind.PART) if part.number else (Kind.PART,))
        ]
        """The tasks whose segments are not in the index, in order."""

    def begin(self, resumed: bool) -> list[SegmentRecord]:
        """Makes the place a stream; genesis has been trained. resumed: it may be one already; gives
        the segments in its index."""
        data = self._files.read(MANIFEST_PATH, MAX_STATE_BYTES)
        self._manifest = manifest = Manifest.from_json(data)
        if not resumed or not self._files.holds(SHAPE.head):
            self._files.begin(data, others_began=True)
            return []
        reader = StreamReader(self._run.config.target, max_gaussians=None)
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
            self._files.append(first * rows.shape[1], new.tobytes())
            self._num_segments += len(new)
            yield (
                task,
                parse_index(new.tobytes(), manifest.num_layers, first),
            )

    def finish(self) -> Manifest:
        """Marks the stream as finished; all tasks are done."""
        assert self._manifest is not None
        assert not self._waiting
        finished = self._manifest.with_live(False)
        write_poster(self._run.config.target, render_splats)
        write_storyboard(self._run.config.target, render_splats)
        self._files.finish(finished.to_json())
        self._files.delete(STATE_FOLDER)
        return finished
