"""Slices, some of which change only some rows of their lane, and a plain model of their display."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from hypothesis import strategies as st

from codec.slice import HIDDEN, Slice, window_births
from codec.splats import Splats
from tests.support.hosted_streams import random_splats


@dataclass(frozen=True, slots=True)
class Lease:
    """The Gaussian in one row of a lane."""

    slice: Slice
    place: int
    """Index of the Gaussian in `slice`."""
    start: int | None
    """First frame in which it shows; None if it never shows."""


def replayed_lane(slices: list[Slice], lane: int, frame: int, swin_size: int) -> list[Lease]:
    """The Gaussians of a lane after all of `slices` born up to `frame`, row by row."""
    held: dict[int, Lease] = {}
    for slice in slices:
        if slice.birth > frame or slice.birth % swin_size != lane:
            continue
        if slice.rows is None:
            held, rows = {}, list(range(len(slice.splats)))
        else:
            rows = slice.rows.tolist()
        for row, lease in held.items():
            if lease.start is not None and lease.start > slice.birth:
                held[row] = replace(lease, start=slice.birth)
        for place, row in enumerate(rows):
            offset = int(slice.start_offsets[place])
            start = None if offset == HIDDEN else slice.birth + offset
            held[row] = Lease(slice, place, start)
    return [held[row] for row in sorted(held)]


def replayed(slices: list[Slice], frame: int, swin_size: int) -> list[Splats]:
    """The Gaussians shown at `frame`, lane by lane, the earliest birth first."""
    lanes = []
    for birth in window_births(frame, swin_size):
        if birth not in [slice.birth for slice in slices]:
            continue
        held = replayed_lane(slices, birth % swin_size, frame, swin_size)
        shown = [one for one in held if one.start is not None and one.start <= frame]
        parts = [one.slice.splats.take(np.array([one.place])) for one in shown]
        empty = Splats.empty(slices[0].splats.sh_degree)
        lanes.append(Splats.concatenate([empty, *parts]))
    return lanes


@dataclass(frozen=True, slots=True)
class LeasedStream:
    """Slices in order of birth, the first `swin_size` of them whole."""

    swin_size: int
    slice_size: int
    sh_degree: int
    slices: list[Slice]

    @property
    def num_frames(self) -> int:
        return self.slices[-1].birth + 1


def changed_rows(
    kind: str, slice_size: int, rng: np.random.Generator
) -> np.ndarray[tuple[int], np.dtype[np.int32]]:
    """Rows of a lane that change, in ascending order."""
    chosen = np.zeros(slice_size, np.bool_)
    if kind == "run":
        first, last = np.sort(rng.integers(0, slice_size + 1, 2))
        chosen[first:last] = True
    else:
        share = {"none": 0.0, "few": 0.02, "half": 0.5, "all": 1.1}[kind]
        chosen = rng.random(slice_size) < share
    return np.flatnonzero(chosen).astype(np.int32)


def leased_slice(
    birth: int, kind: str, swin_size: int, slice_size: int, sh_degree: int, seed: int
) -> Slice:
    """A slice of `kind`: "whole", with any number of Gaussians, or a pattern of changed rows."""
    rng = np.random.default_rng(seed)
    rows = None if kind == "whole" else changed_rows(kind, slice_size, rng)
    count = int(rng.integers(0, slice_size + 1)) if rows is None else len(rows)
    # Some start at the next birth of their lane or later, so that they have not shown by then.
    offsets = rng.integers(0, swin_size + 2, count).astype(np.uint8)
    offsets[rng.random(count) < 0.2] = HIDDEN
    return Slice(birth, random_splats(count, sh_degree, seed), offsets, rows)


@st.composite
def leased_streams(draw: st.DrawFn, slice_sizes: tuple[int, ...] = (1, 7)) -> LeasedStream:
    swin_size = draw(st.sampled_from((1, 2, 5)))
    slice_size = draw(st.sampled_from(slice_sizes))
    sh_degree = draw(st.integers(0, 1))
    kinds = ["none", "few", "half", "all", "run", "whole"]
    later = draw(st.lists(st.sampled_from(kinds), min_size=1, max_size=3 * swin_size + 2))
    seed = draw(st.integers(0, 1 << 20))
    slices = [
        leased_slice(birth, kind, swin_size, slice_size, sh_degree, seed + 100 + birth)
        for birth, kind in enumerate(["whole"] * swin_size + later, 1 - swin_size)
    ]
    return LeasedStream(swin_size, slice_size, sh_degree, slices)
