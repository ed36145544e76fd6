"""A stream as long as it takes: what its index says of each segment, over and over.

Rule: only the manifest and the index are read.
"""

from __future__ import annotations

import logging
import math
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from statistics import fmean

from codec.errors import InvalidError
from codec.stream.reader import StreamReader
from server.abr.media import SegmentSizes, segment_sizes

log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True)
class LoopedMedia:
    """`num_frames` frames of a stream of which the first segment follows the last one.

    Nothing is joined anew there: the slices go on as if a longer stream had been trained.
    """

    segments: tuple[SegmentSizes, ...]
    """Sizes of the stream's segments; each has segment_frames frames if they are repeated."""
    num_frames: int
    fps: float
    segment_frames: int

    @property
    def live(self) -> bool:
        return False

    @property
    def num_layers(self) -> int:
        return len(self.segments[0].layer_bytes)

    @property
    def length_s(self) -> float:
        return self.num_frames / self.fps

    def sizes(self, birth: int) -> SegmentSizes:
        return self.segments[birth // self.segment_frames % len(self.segments)]

    def best_db(self, frames: Iterable[int]) -> list[float]:
        """PSNR of the frames with all layers."""
        return [self.sizes(frame).psnr_db[-1] for frame in frames]

    @property
    def need_bps(self) -> float:
        """Rate of the slices of all frames with all layers, bits per second; without keyframes,
        which not every client is sent."""
        slices_bytes = (self.sizes(frame).slice_bytes[-1] for frame in range(self.num_frames))
        return 8 * self.fps * fmean(slices_bytes)


def open_media(stream: Path, length_s: float) -> LoopedMedia:
    """The first `length_s` seconds of the stream in the folder `stream`, which is repeated where it
    is shorter; a short last segment is left out then. Raises a SwingsError."""
    reader = StreamReader(stream)
    records, manifest = reader.records, reader.manifest
    if not records:
        raise InvalidError(f"{stream} has no frames yet; there is nothing to play")
    if any(math.isnan(db) for record in records for db in record.psnr_db):
        log.warning("%s: its index has no PSNR; the sizes say what layers are worth", stream)
    num_frames = max(1, round(length_s * manifest.fps))
    segment_frames = records[0].num_frames
    if num_frames > reader.num_frames:
        records = [record for record in records if record.num_frames == segment_frames]
    return LoopedMedia(
        segments=tuple(segment_sizes(record, manifest) for record in records),
        num_frames=num_frames,
        fps=manifest.fps,
        segment_frames=segment_frames,
    )
