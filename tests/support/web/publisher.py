"""A stream that grows on a plain file server, segment by segment, like a live recording."""

from __future__ import annotations

import contextlib
import shutil
import threading
from collections.abc import Iterator
from pathlib import Path

from codec.files import append_durably, write_atomic
from codec.stream import StreamReader
from codec.stream.index import INDEX_NAME, pack_record
from codec.stream.manifest import MANIFEST_NAME, SEGMENTS_NAME


class Publisher:
    """Copies a finished export into a folder in steps; the folder always has a valid stream."""

    def __init__(self, exported: Path, folder: Path) -> None:
        self._source = StreamReader(exported)
        self._folder = folder
        self._index_bytes = 0
        self.num_segments = 0
        (folder / SEGMENTS_NAME).mkdir(parents=True)
        write_atomic(folder / INDEX_NAME, b"")
        write_atomic(folder / MANIFEST_NAME, self._source.manifest.with_live(True).to_json())

    @property
    def is_complete(self) -> bool:
        return self.num_segments == len(self._source.records)

    @property
    def num_frames(self) -> int:
        last = self._source.records[self.num_segments - 1]
        return last.first_frame + last.num_frames if self.num_segments else 0

    def publish(self, count: int = 1) -> None:
        """Appends the next segments."""
        for record in self._source.records[self.num_segments : self.num_segments + count]:
            part = Path(SEGMENTS_NAME) / str(record.segment)
            shutil.copytree(Path(self._source.name) / part, self._folder / part)
            packed = pack_record(record)
            append_durably(self._folder / INDEX_NAME, self._index_bytes, packed)
            self._index_bytes += len(packed)
            self.num_segments += 1

    def finish(self) -> None:
        """Appends the rest, and marks the stream as finished in the manifest."""
        self.publish(len(self._source.records))
        write_atomic(self._folder / MANIFEST_NAME, self._source.manifest_json)

    @contextlib.contextmanager
    def running(self, period_s: float) -> Iterator[None]:
        """Publishes a segment every `period_s` during the block, as long as there is one."""
        stop = threading.Event()

        def run() -> None:
            while not stop.wait(period_s) and not self.is_complete:
                self.publish()

        thread = threading.Thread(target=run)
        thread.start()
        try:
            yield
        finally:
            stop.set()
            thread.join()
