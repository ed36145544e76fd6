"""From 3D Gaussians to 2D Gaussians on the pixel grid (recipe v1), in plain torch.

player.render.project in tensors: gradients come from autograd.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from codec.camera import Camera
from player.render.project import jacobian_limits
from player.render.recipe import ALPHA_MIN, LOW_PASS_PX2, MAX_EXTENT_SIGMA, TILE_PX

from .deviceview import DeviceView

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
