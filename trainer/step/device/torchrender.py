"""The rasteriser in plain tensor operations, from top to bottom: project, sort into tiles, blend;
memory stays bounded.

It does what player.render.project and blend do; gradients of the projection come from autograd. The
lists of all tiles are gone through together, a slab of `SLAB` entries at a time, so that a GPU has
thousands of pixels to work on at once; a tile whose pixels have all ended leaves. A slab is cut
into batches of tiles. The backward pass goes the same way, front to back, by the mathematics of
trainer.step.backward, and computes each batch anew, so nothing per pair and pixel outlives its
batch.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import count
from typing import Any

import torch
from torch import Tensor

from codec.camera import Camera
from player.render.blend import MARGIN_PX
from player.render.project import (
    ALPHA_MAX,
    ALPHA_MIN,
    LOW_PASS_PX2,
    MAX_EXTENT_SIGMA,
    TILE_PX,
    TRANSMITTANCE_MIN,
    jacobian_limits,
)

from .tensors import DeviceView

# Columns of what is drawn.
X, Y, CONIC_A, CONIC_B, CONIC_C, OPACITY, RED = range(7)
DRAWN = 9
"""Floats per Gaussian: centre (px), conic, opacity, colour."""


@dataclass(frozen=True, slots=True)
class Solids:
    """N Gaussians in the world, in the units that they are drawn in."""

    means: Tensor  # (N, 3) metres
    quats: Tensor  # (N, 4) wxyz, unit
    scales: Tensor  # (N, 3) metres
    opacities: Tensor  # (N,) 0..1
    colours: Tensor  # (N, 3) as the camera sees them

    def at(self, rows: Tensor) -> Solids:
        """The solids at `rows` (M,) int64."""
        return Solids(
            self.means[rows], self.quats[rows], self.scales[rows], self.opacities[rows],
            self.colours[rows],
        )  # fmt: skip


@dataclass(frozen=True, slots=True)
class Drawn:
    """M Gaussians that show in a picture, nearest first."""

    values: Tensor  # (M, 9) columns as named above
    boxes: Tensor  # (M, 4) int64: first tile and the one after the last, in x and in y
    rows: Tensor  # (M,) int64: which of the solids they are


def rotations(quats: Tensor) -> Tensor:
    """(N, 3, 3) of unit quaternions (N, 4) wxyz."""
    w, x, y, z = quats.unbind(1)
    rows = [
        torch.stack([1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)], 1),
        torch.stack([2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)], 1),
        torch.stack([2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)], 1),
    ]
    return torch.stack(rows, 1)


def _ellipses(solids: Solids, camera: Camera, w2c: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """(N,) depths in metres; (N, 2) centres, px; (N, 3) covariances xx, xy, yy, px^2."""
    mx, my, mz = solids.means.unbind(1)
    # In exactly these steps, see player.render.project.depth_of.
    x, y, z = (((r[0] * mx + r[1] * my) + r[2] * mz) + r[3] for r in w2c[:3])
    u, v = x / z, y / z
    limit_x, limit_y = jacobian_limits(camera)
    tx, ty = u.clamp(-limit_x, limit_x), v.clamp(-limit_y, limit_y)
    # The (2, 3) Jacobian times the camera's rotation, row by row.
    along_x = (camera.fx_px / z)[:, None] * (w2c[0, :3] - tx[:, None] * w2c[2, :3])
    along_y = (camera.fy_px / z)[:, None] * (w2c[1, :3] - ty[:, None] * w2c[2, :3])
    turned = rotations(solids.quats)
    half_x = (along_x[:, :, None] * turned).sum(1) * solids.scales
    half_y = (along_y[:, :, None] * turned).sum(1) * solids.scales
    covariances = torch.stack(
        [
            (half_x * half_x).sum(1) + LOW_PASS_PX2,
            (half_x * half_y).sum(1),
            (half_y * half_y).sum(1) + LOW_PASS_PX2,
        ],
        1,
    )
    centres = torch.stack([camera.fx_px * u + camera.cx_px, camera.fy_px * v + camera.cy_px], 1)
    return z, centres, covariances


def project(solids: Solids, view: DeviceView) -> Drawn:
    """`solids` as `view` sees them, without any nearer than its near plane, too faint or beside the
    picture. Ties in depth keep their order."""
    camera, w2c = view.camera, view.w2c
    with torch.no_grad():
        depths, centres, covariances = _ellipses(solids, camera, w2c)
        xx, xy, yy = covariances.unbind(1)
        # Where an opacity is too small the root is not a number, and nothing shows.
        extents = (2 * torch.log(solids.opacities / ALPHA_MIN)).sqrt().clamp(max=MAX_EXTENT_SIGMA)
        reach = extents[:, None] * torch.stack([xx, yy], 1).sqrt()
        ends, zero = view.tiles, torch.zeros_like(view.tiles)
        low = ((centres - reach) / TILE_PX).floor().clamp(zero, ends)
        high = (((centres + reach) / TILE_PX).floor() + 1).clamp(zero, ends)
        shows = (depths > view.near_m) & (solids.opacities >= ALPHA_MIN) & (xx * yy - xy * xy > 0)
        shows &= (high > low).all(1)
        rows = shows.nonzero()[:, 0]
        rows = rows[torch.argsort(depths[rows], stable=True)]
        low, high = low[rows].long(), high[rows].long()
        boxes = torch.stack([low[:, 0], high[:, 0], low[:, 1], high[:, 1]], 1)
    # Once more for those alone: a gradient of zero would be NaN where nothing could be computed.
    seen = solids.at(rows)
    _, centres, covariances = _ellipses(seen, camera, w2c)
    xx, xy, yy = covariances.unbind(1)
    conics = torch.stack([yy, -xy, xx], 1) / (xx * yy - xy * xy)[:, None]
    return Drawn(
        torch.cat([centres, conics, seen.opacities[:, None], seen.colours], 1), boxes, rows
    )


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
    after the last. See player.render.blend._row_span."""
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
