"""What the stream looks like as far as it goes, for people to look at while parts are trained."""

from __future__ import annotations

from collections.abc import Sequence

from codec.stream import StreamReader
from codec.stream.index import SegmentRecord
from trainer.pictures.framecache import FrameCache
from trainer.run.config import TrainConfig
from trainer.run.outputs import write_snapshot


class JoinPictures:
    """Draws every so many frames of what has joined the stream, beside the capture's."""

    def __init__(self, config: TrainConfig, cache: FrameCache, near_m: float) -> None:
        self._config, self._cache, self._near_m = config, cache, near_m

    def joined(self, records: Sequence[SegmentRecord]) -> None:
        """These have joined the stream now."""
        every = self._config.snapshot_every
        if not every or not records:
            return
        reader = StreamReader(self._config.target)
        first, last = records[0], records[-1]
        for frame in range(first.first_frame, last.first_frame + last.num_frames):
            if frame % every == 0:
                splats = reader.active_splats(frame, reader.manifest.num_layers)
                folder = self._config.work_folder
                write_snapshot(splats, frame, self._cache, self._near_m, folder)
