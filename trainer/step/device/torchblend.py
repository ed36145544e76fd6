"""Blending front to back and its gradients in plain torch, with bounded memory.

The lists of all tiles are gone through together, a slab of `SLAB` entries at a time, so that a GPU
has thousands of pixels to work on at once; a tile whose pixels have all ended leaves. A slab is cut
into batches of tiles. The backward pass goes the same way, front to back, and computes each batch
anew, so nothing per pair and pixel outlives its batch. The mathematics is that of
trainer.step.blend_backward.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import count
from typing import Any

import torch
from torch import Tensor

from player.render.recipe import ALPHA_MAX, ALPHA_MIN, TILE_PX, TRANSMITTANCE_MIN

from .torchproject import CONIC_A, CONIC_B, CONIC_C, DRAWN, OPACITY, RED, X, Y
from .torchtiles import TensorLists

SLAB = 32
"""Entries of a tile's list taken at once. More are more wasted at the end of a list."""

PIXELS = TILE_PX * TILE_PX

PAIR_BYTES = 16 * 4 * PIXELS
"""Most memory of a pair of Gaussian and tile in a batch: 16 planes of float32 pixels."""


@dataclass(frozen=True, slots=True)
class _Slab:
    """SLAB entries of the lists of B tiles, front to back."""

    gaussians: Tensor  # (B, SLAB) int64
    part: Tensor  # (B, SLAB, 9) of what is drawn; opacity 0 beyond the end of a list
    dx: Tensor  # (B, SLAB, 16) pixel centre minus Gaussian's centre
    dy: Tensor  # (B, SLAB, 16)


def _slab(drawn: Tensor, lists: TensorLists, tiles: Tensor, first: int) -> _Slab:
    """Entries from number `first` on of `tiles` (B,)."""
    steps = torch.arange(SLAB, device=drawn.device)
    entries = lists.starts[tiles, None] + first + steps
    is_there = entries < lists.starts[tiles + 1, None]
    gaussians = lists.gaussians[entries.clamp(max=len(lists.gaussians) - 1)]
    part = drawn[gaussians]
    part[..., OPACITY] *= is_there
    places = torch.arange(TILE_PX, device=drawn.device)
    x_px, y_px = tiles % lists.tiles_x * TILE_PX, tiles // lists.tiles_x * TILE_PX
    dx = (x_px[:, None] + 0.5 - part[..., X])[..., None] + places
    dy = (y_px[:, None] + 0.5 - part[..., Y])[..., None] + places
    return _Slab(gaussians, part, dx, dy)


def _unclamped_alphas(slab: _Slab) -> Tensor:
    """(B, SLAB, 256): opacity * exp(-q)."""
    a, b, c = (slab.part[..., column, None] for column in (CONIC_A, CONIC_B, CONIC_C))
    q = (b * slab.dy)[..., None] * slab.dx[..., None, :]
    q += (0.5 * a * slab.dx * slab.dx)[..., None, :]
    q += (0.5 * c * slab.dy * slab.dy)[..., None]
    alphas = q.neg_().exp_().mul_(slab.part[..., OPACITY, None, None])
    return alphas.flatten(2)


def _blended(seen: Tensor, unclamped: Tensor) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """alpha, transmittance before and weight, (B, SLAB, 256) each; and the transmittance after all,
    (B, 256), zero where a pixel has ended. seen: (B, 256) before all."""
    alpha = unclamped.clamp(max=ALPHA_MAX)
    alpha.mul_(alpha >= ALPHA_MIN)
    after = (1 - alpha).cumprod_(1).mul_(seen[:, None])
    before = torch.cat([seen[:, None], after[:, :-1]], 1)
    is_open = after >= TRANSMITTANCE_MIN
    weight = (before * alpha).mul_(is_open)
    return alpha, before, weight, after[:, -1] * is_open[:, -1]


def _batches(seen: Tensor, lengths: Tensor, batch_tiles: int) -> Iterator[tuple[int, Tensor]]:
    """First entry and tiles (B,) of every batch of lists so long; a tile without light in `seen`
    (T, 256), which the caller changes on the way, is left out."""
    for first in count(0, SLAB):
        left = ((lengths > first) & (seen > 0).any(1)).nonzero()[:, 0]
        if not len(left):
            return
        for tiles in torch.split(left, batch_tiles):
            yield first, tiles


class _Blend(torch.autograd.Function):
    """(T, 3, 256) from what is drawn (M, 9)."""

    @staticmethod
    def forward(ctx: Any, drawn: Tensor, lists: TensorLists, batch_tiles: int) -> Tensor:
        tiles = len(lists.starts) - 1
        seen = drawn.new_ones(tiles, PIXELS)
        picture = drawn.new_zeros(tiles, 3, PIXELS)
        for first, batch in _batches(seen, lists.lengths, batch_tiles):
            slab = _slab(drawn, lists, batch, first)
            _, _, weight, after = _blended(seen[batch], _unclamped_alphas(slab))
            seen[batch] = after
            picture[batch] += slab.part[..., RED:].transpose(1, 2) @ weight
        ctx.save_for_backward(drawn, picture)
        ctx.lists, ctx.batch_tiles = lists, batch_tiles
        return picture

    @staticmethod
    def backward(ctx: Any, *given: Tensor) -> tuple[Tensor, None, None]:
        (picture_grad,) = given
        drawn, picture = ctx.saved_tensors
        lists: TensorLists = ctx.lists
        gradient = torch.zeros_like(drawn)
        seen = torch.ones_like(picture[:, 0])
        behind = (picture * picture_grad).sum(1)  # what the rest of the list adds, along d
        for first, batch in _batches(seen, lists.trained_lengths, ctx.batch_tiles):
            slab, d = _slab(drawn, lists, batch, first), picture_grad[batch]
            unclamped = _unclamped_alphas(slab)
            alpha, before, weight, after = _blended(seen[batch], unclamped)
            along = slab.part[..., RED:] @ d
            rest = behind[batch][:, None] - (weight * along).cumsum_(1)
            seen[batch], behind[batch] = after, rest[:, -1]
            # d loss / d alpha times alpha; none where alpha is cut or clamped.
            flow = before.mul_(along).sub_(rest.div_(1 - alpha)).mul_(alpha)
            flow.mul_((weight > 0) & (unclamped <= ALPHA_MAX))
            pairs = torch.cat([_by_shape(slab, flow), weight @ d.transpose(1, 2)], 2)
            gradient.index_add_(0, slab.gaussians.flatten(), pairs.flatten(0, 1))
        return gradient, None, None


def _by_shape(slab: _Slab, flow: Tensor) -> Tensor:
    """(B, SLAB, 6) gradients by centre, conic and opacity. flow: (B, SLAB, 256)."""
    dx, dy = slab.dx, slab.dy
    flow = flow.reshape(*dx.shape, TILE_PX)
    by_row = flow @ torch.stack([torch.ones_like(dx), dx], 3)  # (B, SLAB, 16, 2)
    rows, rows_x = by_row[..., 0], by_row[..., 1]
    total, total_x = rows.sum(2), rows_x.sum(2)
    total_y, total_xy = (rows * dy).sum(2), (rows_x * dy).sum(2)
    total_xx, total_yy = (flow.sum(2) * dx * dx).sum(2), (rows * dy * dy).sum(2)
    a, b, c = (slab.part[..., column] for column in (CONIC_A, CONIC_B, CONIC_C))
    # Beyond the end of a list all is zero, the opacity too.
    by_opacity = total / slab.part[..., OPACITY].clamp(min=ALPHA_MIN)
    return torch.stack(
        [
            a * total_x + b * total_y, b * total_x + c * total_y,
            -0.5 * total_xx, -total_xy, -0.5 * total_yy, by_opacity,
        ],
        2,
    )  # fmt: skip


def blend(drawn: Tensor, lists: TensorLists, batch_bytes: int) -> Tensor:
    """(T, 3, 256): the pixels of every tile, row by row; differentiable by `drawn` (M, 9).

    batch_bytes: what a batch may take beside the picture and its like, in both passes; at least one
    tile's slab, SLAB * PAIR_BYTES = 512 KiB, is computed at once.
    """
    assert drawn.shape[1] == DRAWN
    pictures: Tensor = _Blend.apply(  # type: ignore[no-untyped-call]
        drawn, lists, max(batch_bytes // (SLAB * PAIR_BYTES), 1)
    )
    return pictures
