"""A stream that grows on a plain file server, segment by segment, like a live recording."""

from __future__ import annotations

import shutil
from pathlib import Path

from codec.files import append_durably, write_atomic
from codec.stream import StreamReader
from codec.stream.manifest import MANIFEST_NAME, SEGMENTS_NAME
from codec.stream.segment import INDEX_NAME, pack_record


class Publisher:
    """Copies a finished export into a folder in steps; the folder always has a valid stream."""

    def __init__(self, exported: Path, folder: Path) -> None:
        self._source = StreamReader(exported)
        self._folder = folder
        self._index_bytes = 0
        self.num_segments = 0
        (folder / SEGMENTS_NAME).mkdir(parents=True)
        write_atomic(folder / INDEX_NAME, b"")
        self.manifest = self._source.manifest.with_live(True)
        write_atomic(folder / MANIFEST_NAME, self.manifest.to_json())

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
