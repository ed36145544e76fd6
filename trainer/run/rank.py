"""Slices in the order of what their Gaussians contribute to the training views.

Contributions are summed over the views and over the frames in which a Gaussian shows: what is
small, thin or hidden ranks low however opaque it is. A writer keeps the order with its rank
`given`.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from codec.arrays import Doubles
from codec.errors import InvalidError
from codec.slice import Slice, active_splats
from codec.stream import StreamReader
from codec.stream.layers import Rank
from trainer.fit.observer import Window
from trainer.fit.trainer import Trainer
from trainer.step.contribution import summed_contribution
from trainer.step.raster import Parameters, View

CONTRIBUTION = "contribution"
"""The name of this rank in options."""


def writer_rank(rank: str) -> Rank:
    """The rank with which a StreamWriter keeps slices that are ordered by `rank`."""
    return Rank.GIVEN if rank == CONTRIBUTION else Rank(rank)


def _most_first(part: Slice, importance: Doubles) -> Slice:
    """`part` with its Gaussians by falling importance; equal ones keep their order."""
    order = np.argsort(-importance, kind="stable")
    return Slice(part.birth, part.splats.take(order), part.start_offsets[order])


def slices_by_contribution(reader: StreamReader, views: Sequence[View]) -> Iterator[Slice]:
    """All slices of a stream in order of birth, the Gaussians that contribute most first.

    Every frame is rendered once for each of `views`. Raises InvalidError for a stream without a
    frame.
    """
    manifest = reader.manifest
    if reader.num_frames == 0:
        raise InvalidError(f"{reader.name}: the stream has no finished segment yet")
    sums: dict[int, Doubles] = {}
    window: list[Slice] = []
    for frame in range(reader.num_frames):
        window = reader.window(frame, manifest.num_layers)
        splats = active_splats(window, frame, manifest.swin_size)
        values = Parameters(*splats.arrays)
        rows = np.arange(len(splats), dtype=np.int32)
        contributions = summed_contribution(values, rows, views, [None] * len(views))
        first = 0
        for part in window:
            shown = np.flatnonzero(part.active(frame, manifest.swin_size))
            total = sums.setdefault(part.birth, np.zeros(len(part.splats)))
            total[shown] += contributions[first : first + len(shown)]
            first += len(shown)
        # No later frame shows the oldest slice.
        yield _most_first(window[0], sums.pop(window[0].birth))
    for part in window[1:]:
        yield _most_first(part, sums[part.birth])


def matured_by_contribution(trainer: Trainer, window: Window) -> tuple[Slice, ...]:
    """The slices of `window`, which `trainer` has just given, the Gaussians that contribute most
    first."""
    contributions = trainer.contributions(window)
    return tuple(_most_first(*pair) for pair in zip(window.slices, contributions, strict=True))
