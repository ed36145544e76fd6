"""Pictures of the stream as far as it goes, to look at while parts are trained."""

from __future__ import annotations

from collections.abc import Sequence

from codec.stream import StreamReader
from codec.stream.index import SegmentRecord
from trainer.pictures.framecache import FrameCache
from trainer.run.config import TrainConfig
from trainer.run.outputs import write_snapshot
from trainer.run.prepare import Prepared


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
