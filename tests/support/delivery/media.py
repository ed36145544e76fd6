"""Streams as delivery sees them, made up."""

from __future__ import annotations

from dataclasses import dataclass

from server.abr.media import SegmentSizes

DEMO_BPS = (2.37e6, 3.49e6, 4.95e6, 6.90e6)
"""What one to four layers of the demo's stream took at commit 7f92214, version 1."""


@dataclass
class MadeMedia:
    """A stream whose segments take and give what `segments` says, from the first one on again."""

    segments: tuple[SegmentSizes, ...]
    num_frames: int = 120
    fps: float = 30.0
    swin_size: int = 5
    segment_frames: int = 15
    has_slots: bool = False
    live: bool = False

    @property
    def num_layers(self) -> int:
        return len(self.segments[0].layer_bytes)

    def sizes(self, birth: int) -> SegmentSizes:
        return self.segments[max(0, birth) // self.segment_frames % len(self.segments)]

    def need_bps(self, num_layers: int) -> float:
        """What this many layers take at most, without snapshots."""
        return 8 * self.fps * max(s.slice_bytes[num_layers - 1] for s in self.segments)

    def most_bps(self, num_layers: int) -> float:
        """The same with all snapshots."""
        snapshot_bytes = max(sum(s.snapshot_bytes[:num_layers]) for s in self.segments)
        return self.need_bps(num_layers) + 8 * self.fps * snapshot_bytes / self.segment_frames


def demo_media(num_frames: int = 900) -> MadeMedia:
    """The demo's stream; PSNR as of the basketball in version 1."""
    steps = (b - a for a, b in zip((0.0, *DEMO_BPS), DEMO_BPS, strict=False))
    sizes = tuple(step / 8 / 30 for step in steps)
    return MadeMedia(
        (SegmentSizes(sizes, (25.5, 28.0, 29.1, 29.7)),), num_frames, segment_frames=30
    )


def slot_media(num_frames: int = 900) -> MadeMedia:
    """The basketball in version 2, docs/RESULTS.md."""
    sizes = SegmentSizes(
        (17.7e3, 4.3e3, 5.1e3, 7.0e3),
        (27.82, 28.78, 29.25, 29.69),
        (150e3, 75e3, 85e3, 120e3),
        (0.3, 0.15, 0.15, 0.15),
    )
    return MadeMedia((sizes,), num_frames, swin_size=1, segment_frames=30, has_slots=True)
