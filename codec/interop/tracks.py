"""Frames of a stream in which every Gaussian has a number that it keeps from frame to frame."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from codec.splats import Splats
from codec.stream.reader import StreamReader

Slots = npt.NDArray[np.int64]


@dataclass(frozen=True, slots=True)
class TrackedFrame:
    """What shows at a frame."""

    slots: Slots
    """(N,) the place of each Gaussian in the stream, rising."""
    splats: Splats


def num_slots(reader: StreamReader, layers: int) -> int:
    """The places for Gaussians in the first `layers` layers."""
    layout = reader.manifest.slot_layout
    return layout.swin_size * sum(layout.slots[:layers])


def tracked_frames(reader: StreamReader, frames: range, layers: int) -> Iterator[TrackedFrame]:
    """Each of `frames`, of the first `layers` layers. Raises a CodecError."""
    swin_size = reader.manifest.swin_size
    of_lane = num_slots(reader, layers) // swin_size
    for frame in frames:
        numbers, parts = [], []
        window = reader.window(frame, layers)
        for part in sorted(window, key=lambda part: part.lane(swin_size)):
            rows = np.flatnonzero(part.active(frame, swin_size))
            numbers.append(part.lane(swin_size) * of_lane + rows)
            parts.append(part.splats.take(rows))
        yield TrackedFrame(np.concatenate(numbers), Splats.concatenate(parts))
