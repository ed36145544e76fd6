"""Which Gaussians touch which tile, front to back: player.render.tiles in tensor operations."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from player.render.recipe import ALPHA_MIN, TILE_PX
from player.render.tiles import MARGIN_PX

from .torchproject import CONIC_A, CONIC_B, CONIC_C, OPACITY, Drawn, X, Y


@dataclass(frozen=True, slots=True)
class TensorLists:
    """For every tile its Gaussians from front to back."""

    starts: Tensor  # (tiles + 1,) int64: tile t owns entries starts[t]:starts[t + 1]
    gaussians: Tensor  # (P,) int64: index into what is drawn
    tiles_x: int
    lengths: Tensor  # (tiles,) int64: entries that are blended; 0 where a tile is left out
    trained_lengths: Tensor  # (tiles,) int64: entries up to the last that is trained
    active: Tensor | None = None  # (tiles_y, tiles_x) bool: the tiles that matter; None: all


def _numbered(counts: Tensor) -> tuple[Tensor, Tensor]:
    """For counts (N,): the owner of each of their sum's items, and its number among the owner's."""
    owners = torch.repeat_interleave(torch.arange(len(counts), device=counts.device), counts)
    before = counts.cumsum(0) - counts
    return owners, torch.arange(len(owners), device=counts.device) - before[owners]


def _spans(values: Tensor, boxes: Tensor, owners: Tensor, y: Tensor) -> tuple[Tensor, Tensor]:
    """(R,) int64 each: in row `y` of tiles the first that Gaussian `owners` reaches, and the one
    after the last. See player.render.tiles._row_span."""
    part, box, margin = values[owners], boxes[owners], float(MARGIN_PX)
    a, b, c = part[:, CONIC_A], part[:, CONIC_B], part[:, CONIC_C]
    reach = 2 * torch.log(part[:, OPACITY] / ALPHA_MIN)
    det = a * c - b * b
    tallest = (a * reach / det).sqrt()
    top = y * TILE_PX + 0.5 - part[:, Y] - margin
    bottom = (top + (TILE_PX - 1 + 2 * margin)).minimum(tallest)
    top = top.maximum(-tallest)
    turn = -b * (reach / (c * det)).sqrt()
    right_y, left_y = turn.maximum(top).minimum(bottom), (-turn).maximum(top).minimum(bottom)
    right_root = (a * reach - det * right_y * right_y).clamp(min=0).sqrt()
    left_root = (a * reach - det * left_y * left_y).clamp(min=0).sqrt()
    right = part[:, X] + (right_root - b * right_y) / a + margin
    left = part[:, X] - (left_root + b * left_y) / a - margin
    # A tile's pixel centres begin half a pixel inside it and end half a pixel before the next.
    end = (((right - 0.5) / TILE_PX).floor().long() + 1).minimum(box[:, 1]).maximum(box[:, 0])
    first = (((left + 0.5) / TILE_PX).ceil().long() - 1).maximum(box[:, 0]).minimum(end)
    return torch.where(top > bottom, end, first), end


@torch.no_grad()
def tensor_lists(
    drawn: Drawn, tiles_x: int, tiles_y: int, num_solids: int, trained: int, whole: bool
) -> TensorLists:
    """The tiles that the Gaussians reach, each with those that reach it, nearest first.

    trained: gradients are of solids before this one of `num_solids`. whole: whether all tiles are
    blended; else only those that such a solid reaches, and their neighbours.
    """
    boxes = drawn.boxes
    owners, rows = _numbered(boxes[:, 3] - boxes[:, 2])
    y = boxes[owners, 2] + rows
    first, end = _spans(drawn.values, boxes, owners, y)
    spans, columns = _numbered(end - first)
    tiles = y[spans] * tiles_x + first[spans] + columns
    # Stable: within a tile they stay nearest first.
    tiles, order = torch.sort(tiles, stable=True)
    gaussians = owners[spans][order]
    counts = torch.bincount(tiles, minlength=tiles_x * tiles_y)
    starts = torch.cat([counts.new_zeros(1), counts.cumsum(0)])
    if whole and trained == num_solids:
        return TensorLists(starts, gaussians, tiles_x, counts, counts)
    places = torch.arange(1, len(tiles) + 1, device=tiles.device) - starts[tiles]
    places *= drawn.rows[gaussians] < trained
    ends = torch.zeros_like(counts).scatter_reduce_(0, tiles, places, "amax")
    if whole:
        return TensorLists(starts, gaussians, tiles_x, counts, ends)
    active = (ends > 0).reshape(tiles_y, tiles_x)
    wanted = torch.nn.functional.max_pool2d(active[None].float(), 3, 1, 1).flatten() > 0
    return TensorLists(starts, gaussians, tiles_x, counts * wanted, ends, active)
