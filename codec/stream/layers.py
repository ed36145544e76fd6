"""A slice cut into layers by importance, and put together again.

Rule: layers 0..n are always usable together, for any n; a layer alone is of no use.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from enum import StrEnum
from itertools import accumulate, pairwise

import numpy as np

from codec.errors import CorruptError, InvalidError
from codec.slice import Slice
from codec.slots.slotlayout import MAX_LAYERS
from codec.splats import Floats, Splats

from .chunk import Chunk

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
    """(N,) importance by place: whoever made the slice has put the most important first."""
    places: Floats = -np.arange(len(splats), dtype=np.float32)
    return places


class Rank(StrEnum):
    """What orders a slice into layers; RANKS says how.

    An importance that Gaussians alone do not tell (what they add to pictures, say) comes in as the
    order of the slice, with `given`.
    """

    OPACITY = "opacity"
    COVERAGE = "coverage"
    GIVEN = "given"


RANKS: dict[Rank, RankFunction] = {
    Rank.OPACITY: opacity_rank,
    Rank.COVERAGE: coverage_rank,
    Rank.GIVEN: given_rank,
}


def check_shares(shares: Sequence[float]) -> None:
    """Raises InvalidError unless `shares` are 1 to MAX_LAYERS positive numbers that sum to 1."""
    if not 1 <= len(shares) <= MAX_LAYERS:
        raise InvalidError(f"layers: {len(shares)} shares, expected 1 to {MAX_LAYERS}")
    if not all(0 < share <= 1 for share in shares) or abs(sum(shares) - 1) > 1e-6:
        raise InvalidError(f"layers: the shares {tuple(shares)} are not positive with sum 1")


def split_counts(count: int, shares: tuple[float, ...]) -> tuple[int, ...]:
    """How many of `count` Gaussians each layer has; it may have none."""
    edges = np.rint(np.cumsum((0.0, *shares)) * count).astype(np.int64)
    edges[-1] = count
    return tuple(np.diff(edges).tolist())


def split_layers(slice: Slice, shares: tuple[float, ...], rank: RankFunction) -> list[Slice]:
    """One Slice for each share, the most important Gaussians first.

    Inside a layer the Gaussians keep their order; equal ranks fall to the earlier layer in order.
    """
    check_shares(shares)
    count = len(slice.splats)
    order = np.argsort(-rank(slice.splats), kind="stable")
    layers = []
    for first, last in pairwise((0, *accumulate(split_counts(count, shares)))):
        rows = np.sort(order[first:last])
        layers.append(Slice(slice.birth, slice.splats.take(rows), slice.start_offsets[rows]))
    return layers


def merge_layers(chunks: Sequence[Chunk]) -> Slice:
    """The slice that `chunks`, layers 0..n of one birth in order, make together."""
    if not chunks:
        raise CorruptError("layers: a slice needs at least layer 0")
    birth = chunks[0].birth
    for layer, chunk in enumerate(chunks):
        if chunk.birth != birth or chunk.layer != layer:
            raise CorruptError(
                f"layers: found birth {chunk.birth} layer {chunk.layer} "
                f"where birth {birth} layer {layer} belongs"
            )
        if chunk.slice.splats.sh_degree != chunks[0].slice.splats.sh_degree:
            raise CorruptError(f"layers: birth {birth} layer {layer} has another SH degree")
    if len(chunks) == 1:
        return chunks[0].slice
    return Slice(
        birth,
        Splats.concatenate([chunk.slice.splats for chunk in chunks]),
        np.concatenate([chunk.slice.start_offsets for chunk in chunks]),
    )
