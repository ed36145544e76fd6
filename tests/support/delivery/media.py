"""Made-up streams for tests of delivery."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import accumulate

from server.abr.media import SegmentSizes


def sizes_of(
    layer_bytes: tuple[float, ...],
    gains_db: tuple[float, ...],
    keyframe_bytes: tuple[float, ...] | None = None,
) -> SegmentSizes:
    """Sizes with these gains; a slice changes a tenth of each layer. By default a keyframe is as
    large as five slices."""
    if keyframe_bytes is None:
        keyframe_bytes = tuple(5 * size for size in layer_bytes)
    shares = (0.1,) * len(layer_bytes)
    return SegmentSizes(layer_bytes, tuple(accumulate(gains_db)), keyframe_bytes, shares)


@dataclass
class MadeMedia:
    """A stream whose segments have the sizes and qualities of `segments`, repeated."""

    segments: tuple[SegmentSizes, ...]
    num_frames: int = 120
    fps: float = 30.0
    segment_frames: int = 15
    live: bool = False

    @property
    def num_layers(self) -> int:
        return len(self.segments[0].layer_bytes)

    def sizes(self, birth: int) -> SegmentSizes:
        return self.segments[birth // self.segment_frames % len(self.segments)]

    def need_bps(self, num_layers: int) -> float:
        """Maximum rate of this many layers, without keyframes."""
        return 8 * self.fps * max(s.slice_bytes[num_layers - 1] for s in self.segments)

    def most_bps(self, num_layers: int) -> float:
        """Maximum rate of this many layers, with all keyframes."""
        keyframe_bytes = max(sum(s.keyframe_bytes[:num_layers]) for s in self.segments)
        return self.need_bps(num_layers) + 8 * self.fps * keyframe_bytes / self.segment_frames


def basketball_media(num_frames: int = 900) -> MadeMedia:
    """The basketball stream of docs/RESULTS.md."""
    sizes = SegmentSizes(
        (17.7e3, 4.3e3, 5.1e3, 7.0e3),
        (27.82, 28.78, 29.25, 29.69),
        (150e3, 75e3, 85e3, 120e3),
        (0.3, 0.15, 0.15, 0.15),
    )
    return MadeMedia((sizes,), num_frames, segment_frames=30)
