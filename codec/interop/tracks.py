"""Frames in which every Gaussian has a number that it keeps from frame to frame."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Protocol

import numpy as np
import numpy.typing as npt

from codec.splats import Splats
from codec.stream.reader import StreamReader

Slots = npt.NDArray[np.int64]


@dataclass(frozen=True, slots=True)
class TrackedFrame:
    """The Gaussians that show at a frame."""

    slots: Slots
    """(N,) the place of each Gaussian, rising."""
    splats: Splats


class Tracks(Protocol):
    """A sequence that can be gone through more than once."""

    @property
    def name(self) -> str:
        """Its name in errors."""

    @property
    def fps(self) -> float: ...

    @property
    def num_frames(self) -> int: ...

    @property
    def num_slots(self) -> int:
        """Places for Gaussians."""

    def __iter__(self) -> Iterator[TrackedFrame]:
        """Raises a CodecError."""


@dataclass(frozen=True, slots=True)
class StreamTracks:
    """`frames` of a stream, of its first `layers` layers."""

    reader: StreamReader
    frames: range
    layers: int

    @property
    def name(self) -> str:
        return self.reader.name

    @property
    def fps(self) -> float:
        return self.reader.manifest.fps

    @property
    def num_frames(self) -> int:
        return len(self.frames)

    @property
    def num_slots(self) -> int:
        layout = self.reader.manifest.slot_layout
        return layout.swin_size * sum(layout.slots[: self.layers])

    def __iter__(self) -> Iterator[TrackedFrame]:
        """Raises a CodecError."""
        swin_size = self.reader.manifest.swin_size
        of_lane = self.num_slots // swin_size
        for frame in self.frames:
            numbers, parts = [], []
            window = self.reader.window(frame, self.layers)
            for part in sorted(window, key=lambda part: part.lane(swin_size)):
                rows = np.flatnonzero(part.active(frame, swin_size))
                numbers.append(part.lane(swin_size) * of_lane + rows)
                parts.append(part.splats.take(rows))
            yield TrackedFrame(np.concatenate(numbers), Splats.concatenate(parts))
