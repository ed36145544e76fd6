"""Puts the pieces of a stream together: their index, in order, as far as it goes."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

from codec.errors import InvalidError
from codec.storage.openstorage import open_growing
from codec.stream import StreamReader
from codec.stream.finishing import focus_of
from codec.stream.index import SegmentRecord, parse_index, record_bytes
from codec.stream.manifest import Manifest, object_name
from codec.stream.poster import write_poster
from codec.stream.storyboard import write_storyboard
from codec.stream.writer import SHAPE
from player.render.cpu import render_splats
from trainer.run.capturesound import SOURCE, CaptureSound

from .part_state import MANIFEST_PATH, MAX_STATE_BYTES, unpack_arrays
from .task import STATE_FOLDER, Run, Task


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
