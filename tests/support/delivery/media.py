"""Streams as delivery sees them, made up."""

from __future__ import annotations

from dataclasses import dataclass

from server.abr.media import SegmentSizes

DEMO_BPS = (2.37e6, 3.49e6, 4.95e6, 6.90e6)
"""What one to four layers of the demo's stream took at commit 7f92214, version 1."""


@dataclass
class FakeMedia:
    """A stream of equal segments."""

    every: SegmentSizes
    num_frames: int = 900
    fps: float = 30.0
    swin_size: int = 5
    segment_frames: int = 30
    live: bool = False
    has_slots: bool = False

    @property
    def num_layers(self) -> int:
        return len(self.every.layer_bytes)

    def sizes(self, birth: int) -> SegmentSizes:
        return self.every

    def need_bps(self, layers: int) -> float:
        """What so many layers take."""
        return 8 * self.fps * self.every.slice_bytes[layers - 1]


def demo_media(num_frames: int = 900) -> FakeMedia:
    """The demo's stream; PSNR as of the basketball in version 1."""
    steps = (b - a for a, b in zip((0.0, *DEMO_BPS), DEMO_BPS, strict=False))
    sizes = tuple(step / 8 / 30 for step in steps)
    return FakeMedia(SegmentSizes(sizes, (25.5, 28.0, 29.1, 29.7)), num_frames)


def slot_media(num_frames: int = 900) -> FakeMedia:
    """The basketball in version 2, docs/RESULTS.md."""
    sizes = SegmentSizes(
        (17.7e3, 4.3e3, 5.1e3, 7.0e3),
        (27.82, 28.78, 29.25, 29.69),
        (150e3, 75e3, 85e3, 120e3),
        (0.3, 0.15, 0.15, 0.15),
    )
    return FakeMedia(sizes, num_frames, swin_size=1, has_slots=True)
