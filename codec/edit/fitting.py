"""The steps of an edit that rounds, chosen so that the edited stream is not larger than its source.

Gaussians along the axes that are turned take more bits. Slightly larger steps save them, but not
always: an oblique turn of a model with few harmonics gives it many. Then the steps stay as they
were, and the stream grows.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from codec.stream.manifest import Part
from codec.stream.reader import StreamReader

from .edit import Edit
from .recoder import Recoder
from .segmentfiles import Scores, SegmentFiles
from .walk import Walk

MOST = 2.0
"""Largest factor of the steps: 6 dB of the error that rounding makes."""

FIRST = 1.08
"""The factor that is tried after 1."""

LEAST = 1.01
"""Least factor from one try to the next."""

TRIES = 8


class Weighed(SegmentFiles):
    """Segments that are encoded only to measure their size; nothing is written."""

    weight_bytes = 0

    def add(self, objects: Mapping[Part, bytes], num_frames: int, psnr_db: Scores | None) -> None:
        self.weight_bytes += sum(map(len, objects.values()))


def fitted(reader: StreamReader, edit: Edit) -> Edit:
    """`edit`, with the smallest steps found with which the first segment of the stream of `reader`
    takes no more bytes than before; as it is if MOST is not enough. Raises a SwingsError."""
    if not edit.rounds:
        return edit
    limit_bytes, made, log_factor = sum(reader.records[0].part_bytes), edit, 0.0
    first_excess_bytes, most = 0, np.log(MOST)
    for tries in range(TRIES):
        excess_bytes = first_segment_bytes(reader, made) - limit_bytes
        if excess_bytes <= 0:
            return made
        if log_factor >= most:
            break
        step = np.log(FIRST)
        if not tries:
            first_excess_bytes = excess_bytes
        elif tries == TRIES - 2:
            step = most
        elif first_excess_bytes > excess_bytes:
            # Sizes fall about evenly, but not from one factor to a near one.
            step = log_factor * excess_bytes / (first_excess_bytes - excess_bytes)
        log_factor = min(log_factor + max(step, np.log(LEAST)), most)
        made = edit.coarser(float(np.exp(log_factor)))
    return edit


def first_segment_bytes(reader: StreamReader, edit: Edit) -> int:
    """Size of the objects of the first segment after `edit`."""
    files = Weighed(Path(), edit.manifest(reader.manifest))
    walk, recoder = Walk(reader), Recoder(files)
    for slices in (walk.opening(0), walk.slices(range(1, reader.records[0].num_frames))):
        for _ in recoder.append(walk, slices, edit):
            pass
    recoder.end_segment()
    return files.weight_bytes
