"""Slices, some of which change only some rows of their lane, and a plain model of their display."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from hypothesis import strategies as st

from codec.slice import HIDDEN, Slice, window_births
from codec.splats import Splats
from tests.support.hosted_streams import random_splats


def replayed_lane(slices: list[Slice], frame: int, sh_degree: int) -> Splats:
    """The Gaussians shown at `frame` of a lane with `slices`, row by row."""
    held: dict[int, tuple[float, Slice, int]] = {}
    """By row: first frame in which its Gaussian shows, its slice and its index there."""
    for slice in slices:
        rows = range(len(slice.splats)) if slice.rows is None else slice.rows.tolist()
        kept = {} if slice.rows is None else held
        held = {
            row: (start if start == math.inf else min(start, slice.birth), whose, place)
            for row, (start, whose, place) in kept.items()
        }
        for place, (row, offset) in enumerate(zip(rows, slice.start_offsets.tolist(), strict=True)):
            start = math.inf if offset == HIDDEN else slice.birth + offset
            held[row] = start, slice, place
    shown = [held[row] for row in sorted(held) if held[row][0] <= frame]
    parts = [slice.splats.take(np.array([place])) for _, slice, place in shown]
    return Splats.concatenate([Splats.empty(sh_degree), *parts])


def replayed(slices: list[Slice], frame: int, swin_size: int) -> list[Splats]:
    """The Gaussians shown at `frame`, lane by lane, the earliest birth first."""
    lanes = []
    for birth in window_births(frame, swin_size):
        born = range(birth, -swin_size, -swin_size)
        mine = [one for one in slices if one.birth in born]
        if mine and mine[-1].birth == birth:
            lanes.append(replayed_lane(mine, frame, slices[0].splats.sh_degree))
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


SHARES = {"none": 0.0, "few": 0.02, "half": 0.5, "all": 1.1}
"""Shares of the rows of a lane that change. A "run" is of rows that follow one another."""


def leased_slice(
    birth: int, kind: str, swin_size: int, slice_size: int, sh_degree: int, seed: int
) -> Slice:
    """A slice of `kind`: "whole", with any number of Gaussians, or a pattern of changed rows."""
    rng = np.random.default_rng(seed)
    rows = None
    if kind == "run":
        rows = np.arange(*np.sort(rng.integers(0, slice_size + 1, 2)), dtype=np.int32)
    elif kind != "whole":
        rows = np.flatnonzero(rng.random(slice_size) < SHARES[kind]).astype(np.int32)
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
    kinds = st.sampled_from([*SHARES, "run", "whole"])
    later = draw(st.lists(kinds, min_size=1, max_size=3 * swin_size + 2))
    seed = draw(st.integers(0, 1 << 20))
    slices = [
        leased_slice(birth, kind, swin_size, slice_size, sh_degree, seed + 100 + birth)
        for birth, kind in enumerate(["whole"] * swin_size + later, 1 - swin_size)
    ]
    return LeasedStream(swin_size, slice_size, sh_degree, slices)
