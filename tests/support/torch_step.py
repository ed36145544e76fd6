"""A training step in plain torch, without kernels of our own: vectorised over pixels and Gaussians,
culled by tiles as the CPU rasteriser is, gradients from autograd."""

from __future__ import annotations

import torch
from torch import Tensor

from codec.camera import Camera
from codec.splats import SH_C0, Floats
from player.render.recipe import (
    ALPHA_MAX,
    ALPHA_MIN,
    JACOBIAN_CLAMP,
    LOW_PASS_PX2,
    MAX_EXTENT_SIGMA,
    TILE_PX,
    TRANSMITTANCE_MIN,
)
from tests.support.reference_render import rotations
from trainer.fit.optimiser import OptimiserConfig
from trainer.step.loss import C1, C2, RADIUS_PX, TAPS
from trainer.step.raster import Parameters


class TorchStep:
    """Parameters of Gaussians of SH degree 0 and the step that changes them, all float32."""

    def __init__(
        self,
        values: Parameters,
        camera: Camera,
        near_m: float,
        target: Floats,
        dssim_weight: float,
        config: OptimiserConfig,
        means_lr: float,
    ) -> None:
        """target: (3, H, W) in 0..1; means_lr: metres."""
        self.camera, self.near_m, self.dssim_weight = camera, near_m, dssim_weight
        self.target = torch.tensor(target)
        self.gain = torch.ones(3, 1, 1, requires_grad=True)
        self.bias = torch.zeros(3, 1, 1, requires_grad=True)
        self.leaves = [torch.tensor(array, requires_grad=True) for array in values.arrays]
        rates = (
            means_lr, config.log_scales_lr, config.quats_lr, config.logit_opacities_lr,
            config.sh_lr,
        )  # fmt: skip
        groups = [{"params": [p], "lr": r} for p, r in zip(self.leaves, rates, strict=True)]
        self.adam = torch.optim.Adam(groups, eps=config.eps)
        rows, columns = -(-camera.height_px // TILE_PX), -(-camera.width_px // TILE_PX)
        self.tiles = [(row, column) for row in range(rows) for column in range(columns)]
        self.grid = rows, columns
        v, u = torch.meshgrid(torch.arange(TILE_PX), torch.arange(TILE_PX), indexing="ij")
        self.pixels = torch.stack([u, v], -1).reshape(-1, 1, 2) + 0.5

    def step(self) -> float:
        """The loss, after which every parameter has moved."""
        self.adam.zero_grad()
        self.gain.grad = self.bias.grad = None
        loss = self.loss(self.picture())
        torch.autograd.backward(loss)
        self.adam.step()
        return loss.item()

    def picture(self) -> Tensor:
        """(3, H, W)."""
        drawn, low_px, high_px = self.projected()
        rows, columns = self.grid
        edges = torch.arange(max(rows, columns))[:, None] * TILE_PX
        in_column = (low_px[:, 0] < edges + TILE_PX) & (high_px[:, 0] > edges)
        in_row = (low_px[:, 1] < edges + TILE_PX) & (high_px[:, 1] > edges)
        found = [(in_row[r] & in_column[c]).nonzero()[:, 0] for r, c in self.tiles]
        lists = torch.split(drawn[torch.cat(found)], [len(ids) for ids in found])
        blocks = [self.tile(*tile, part) for tile, part in zip(self.tiles, lists, strict=True)]
        whole = torch.stack(blocks).reshape(rows, columns, TILE_PX, TILE_PX, 3)
        planar = whole.permute(4, 0, 2, 1, 3).reshape(3, rows * TILE_PX, columns * TILE_PX)
        return planar[:, : self.camera.height_px, : self.camera.width_px]

    def projected(self) -> tuple[Tensor, Tensor, Tensor]:
        """What is in front of the camera, nearest first: (M, 9) centre, conic (xx, xy, yy), opacity
        and colour; (M, 2) low and high corners of the boxes, pixels."""
        camera = self.camera
        means, log_scales, quats, logits, sh = self.leaves
        w2c = torch.tensor(camera.w2c, dtype=torch.float32)
        in_camera = means @ w2c[:3, :3].T + w2c[:3, 3]
        order = torch.argsort(in_camera[:, 2].detach())
        shows = (in_camera[order, 2] > self.near_m) & (torch.sigmoid(logits[order]) >= ALPHA_MIN)
        order = order[shows]
        x, y, z = in_camera[order].unbind(1)
        limit_x = JACOBIAN_CLAMP * 0.5 * camera.width_px / camera.fx_px
        limit_y = JACOBIAN_CLAMP * 0.5 * camera.height_px / camera.fy_px
        tx, ty = (x / z).clamp(-limit_x, limit_x), (y / z).clamp(-limit_y, limit_y)
        zero = torch.zeros_like(z)
        jacobian = torch.stack(
            [
                torch.stack([camera.fx_px / z, zero, -camera.fx_px * tx / z], 1),
                torch.stack([zero, camera.fy_px / z, -camera.fy_px * ty / z], 1),
            ],
            1,
        )
        factor = rotations(quats[order]) * log_scales[order].exp()[:, None, :]
        half = jacobian @ w2c[:3, :3] @ factor
        covariance = half @ half.transpose(1, 2)
        xx, xy = covariance[:, 0, 0] + LOW_PASS_PX2, covariance[:, 0, 1]
        yy = covariance[:, 1, 1] + LOW_PASS_PX2
        conic = torch.stack([yy, -xy, xx], 1) / (xx * yy - xy * xy)[:, None]
        u = camera.fx_px * x / z + camera.cx_px
        v = camera.fy_px * y / z + camera.cy_px
        centre = torch.stack([u, v], 1)
        opacity = torch.sigmoid(logits[order])
        colour = (0.5 + SH_C0 * sh[order, 0]).clamp(min=0)
        with torch.no_grad():
            extent = (2 * torch.log(opacity / ALPHA_MIN)).sqrt().clamp(max=MAX_EXTENT_SIGMA)
            reach_px = extent[:, None] * torch.stack([xx, yy], 1).sqrt()
            low_px, high_px = centre - reach_px, centre + reach_px
        return torch.cat([centre, conic, opacity[:, None], colour], 1), low_px, high_px

    def tile(self, row: int, column: int, drawn: Tensor) -> Tensor:
        """(256, 3) the pixels of a tile that shows `drawn`, (K, 9)."""
        corner = torch.tensor([column * TILE_PX, row * TILE_PX])
        dx, dy = (drawn[:, :2] - (self.pixels + corner)).unbind(-1)
        xx, xy, yy = drawn[:, 2:5].unbind(1)
        exponent = -0.5 * (xx * dx * dx + yy * dy * dy) - xy * dx * dy
        alpha = (drawn[:, 5] * exponent.exp()).clamp(max=ALPHA_MAX)
        alpha = torch.where(alpha >= ALPHA_MIN, alpha, 0)
        after = torch.cumprod(1 - alpha, 1)
        before = torch.cat([torch.ones_like(after[:, :1]), after[:, :-1]], 1)
        weights = torch.where(after >= TRANSMITTANCE_MIN, before * alpha, 0)
        colours: Tensor = weights @ drawn[:, 6:]
        return colours

    def loss(self, picture: Tensor) -> Tensor:
        """(1 - weight) L1 + weight (1 - SSIM), as trainer/step/loss.py has it."""
        pred, target = self.gain * picture + self.bias, self.target
        taps = torch.tensor(TAPS)
        maps = torch.stack([pred, target, pred * pred, target * target, pred * target])
        planes = maps.reshape(-1, 1, *maps.shape[2:])
        planes = torch.nn.functional.conv2d(planes, taps[None, None, None], padding=(0, RADIUS_PX))
        planes = torch.nn.functional.conv2d(
            planes, taps[None, None, :, None], padding=(RADIUS_PX, 0)
        )
        mu_p, mu_t, pp, tt, pt = planes.reshape(maps.shape)
        var_p, var_t, cov = pp - mu_p**2, tt - mu_t**2, pt - mu_p * mu_t
        ssim = ((2 * mu_p * mu_t + C1) * (2 * cov + C2)) / (
            (mu_p**2 + mu_t**2 + C1) * (var_p + var_t + C2)
        )
        l1 = (pred - target).abs().mean()
        total: Tensor = (1 - self.dssim_weight) * l1 + self.dssim_weight * (1 - ssim.mean())
        return total
