"""The stream as delivery sees it: the size of each packet, and its gain in quality.

Rule: sizes and qualities only; the bytes themselves are handled elsewhere.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import accumulate, pairwise
from typing import Protocol

from codec.stream.manifest import Manifest
from codec.stream.segment import SegmentRecord

UNKNOWN_GAIN_DB = 3.0
"""Assumed gain from twice the bytes, if the index has no quality, dB."""

SENT_SHARE_OF_WHOLE = 0.4
"""Bytes of a Gaussian that a slice predicts, as a share of what it takes in a keyframe. Measured
on the basketball, docs/RESULTS.md."""


@dataclass(frozen=True)
class SegmentSizes:
    """Sizes and qualities of a segment's slices; the tuples have one entry per layer."""

    layer_bytes: tuple[float, ...]
    """Mean bytes of a slice's packet of this layer; that of the skip map is counted with layer
    0."""
    psnr_db: tuple[float, ...]
    """PSNR of the layers up to this one together, dB; rising."""
    keyframe_bytes: tuple[float, ...]
    """Bytes of the layer's keyframe at the segment's first frame."""
    changed_shares: tuple[float, ...]
    """Share of the layer's slots that a slice changes."""

    @cached_property
    def gains_db(self) -> tuple[float, ...]:
        """Gain of each layer over the layers below it, dB; for layer 0 its PSNR."""
        return (self.psnr_db[0], *(b - a for a, b in pairwise(self.psnr_db)))

    @cached_property
    def slice_bytes(self) -> tuple[float, ...]:
        """Mean bytes of a slice with 1, 2, ... layers."""
        return tuple(accumulate(self.layer_bytes))


class Media(Protocol):
    """The stream that is delivered; it may grow between two calls."""

    @property
    def fps(self) -> float: ...

    @property
    def segment_frames(self) -> int: ...

    @property
    def num_frames(self) -> int:
        """Frames that can be sent now."""
        ...

    @property
    def live(self) -> bool:
        """Whether num_frames may still grow."""
        ...

    @property
    def num_layers(self) -> int: ...

    def sizes(self, birth: int) -> SegmentSizes:
        """Sizes of the segment of the slice born at `birth`."""
        ...


class RecordedMedia:
    """A stream as described by its manifest and its index."""

    def __init__(self, manifest: Manifest, records: Sequence[SegmentRecord]) -> None:
        """records: may grow."""
        self.manifest = manifest
        """Replaced by another manifest when a live stream ends."""
        self._records = records
        self._sizes: dict[int, SegmentSizes] = {}

    @property
    def fps(self) -> float:
        return self.manifest.fps

    @property
    def segment_frames(self) -> int:
        return self.manifest.segment_frames

    @property
    def num_frames(self) -> int:
        last = self._records[-1] if self._records else None
        return last.first_frame + last.num_frames if last else 0

    @property
    def live(self) -> bool:
        return self.manifest.live

    @property
    def num_layers(self) -> int:
        return self.manifest.num_layers

    def sizes(self, birth: int) -> SegmentSizes:
        """Sizes of the segment of `birth` by the index, as first read."""
        segment = self.manifest.segment_of(birth)
        found = self._sizes.get(segment)
        if found is None:
            found = self._sizes[segment] = segment_sizes(self._records[segment], self.manifest)
        return found


def segment_start(media: Media, birth: int) -> int:
    """The first frame of the segment of the slice born at `birth`."""
    return birth - birth % media.segment_frames


def rising(psnr_db: Sequence[float], layer_bytes: Sequence[float]) -> tuple[float, ...]:
    """`psnr_db` without what no player can use: never falling from one layer to the next, and
    guessed from the sizes where it is unknown."""
    totals = list(accumulate(layer_bytes))
    if any(map(math.isnan, psnr_db)):
        whole = max(totals[-1], 1.0)
        psnr_db = [30 + UNKNOWN_GAIN_DB * math.log2(max(t, 1.0) / whole) for t in totals]
    return tuple(accumulate(psnr_db, max))


def segment_sizes(record: SegmentRecord, manifest: Manifest) -> SegmentSizes:
    """Sizes and qualities of a segment, from its index record."""
    births = len(manifest.births(record.segment, record.num_frames))
    layer_bytes = [size / births for size in record.object_bytes]
    skip_maps_bytes, *keyframe_bytes = record.side_bytes
    # A slice has one lane of slots, so it cannot change more.
    shares = [
        min(1 / manifest.swin_size, sent / max(1.0, SENT_SHARE_OF_WHOLE * whole))
        for sent, whole in zip(layer_bytes, keyframe_bytes, strict=True)
    ]
    layer_bytes[0] += skip_maps_bytes / births
    return SegmentSizes(
        tuple(layer_bytes),
        rising(record.psnr_db, layer_bytes),
        tuple(map(float, keyframe_bytes)),
        tuple(shares),
    )
