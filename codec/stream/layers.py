"""A slice cut into layers by importance.

Rule: layers 0..n are always usable together, for any n; a layer alone is of no use.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from enum import StrEnum
from itertools import accumulate, pairwise

import numpy as np

from codec.arrays import Floats, Longs
from codec.splats import Splats

RankFunction = Callable[[Splats], Floats]
"""Gives (N,) importances; the higher, the earlier the layer."""


def opacity_rank(splats: Splats) -> Floats:
    """(N,) importance by opacity alone, as the paper drops the tail of a slice."""
    return splats.logit_opacities


def coverage_rank(splats: Splats) -> Floats:
    """(N,) importance by what a Gaussian can paint: opacity times its widest section."""
    scales = splats.log_scales.astype(np.float64)
    widest = scales.sum(axis=1) - scales.min(axis=1)
    log_opacity = -np.logaddexp(0.0, -splats.logit_opacities.astype(np.float64))
    importance: Floats = (widest + log_opacity).astype(np.float32)
    return importance


def given_rank(splats: Splats) -> Floats:
    """(N,) importance by place in the slice, the most important first."""
    places: Floats = -np.arange(len(splats), dtype=np.float32)
    return places


class Rank(StrEnum):
    """The measure by which a slice is ordered into layers; RANKS has the functions.

    An importance that does not follow from the Gaussians alone, such as what they add to pictures,
    is given by the order of the slice, with `given`.
    """

    OPACITY = "opacity"
    COVERAGE = "coverage"
    GIVEN = "given"


RANKS: dict[Rank, RankFunction] = {
    Rank.OPACITY: opacity_rank,
    Rank.COVERAGE: coverage_rank,
    Rank.GIVEN: given_rank,
}


def split_counts(count: int, shares: tuple[float, ...]) -> tuple[int, ...]:
    """How many of `count` Gaussians each layer has; it may have none."""
    edges = np.rint(np.cumsum((0.0, *shares)) * count).astype(np.int64)
    edges[-1] = count
    return tuple(np.diff(edges).tolist())


def layer_counts(count: int, slots: Sequence[int]) -> tuple[int, ...]:
    """How many of `count` Gaussians, sum(slots) at most, each layer takes into its slots: about
    equally full ones."""
    return split_counts(count, tuple(n / sum(slots) for n in slots))


def split_layers(splats: Splats, slots: Sequence[int], rank: RankFunction) -> list[Longs]:
    """The rows of `splats` that belong into each layer, the most important ones first.

    Inside a layer they keep their order; equal ranks fall to the earlier layer in order.
    """
    order = np.argsort(-rank(splats), kind="stable")
    edges = pairwise(accumulate(layer_counts(len(splats), slots), initial=0))
    return [np.sort(order[first:last]) for first, last in edges]
