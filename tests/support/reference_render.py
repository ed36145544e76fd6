"""Recipe v1 in plain torch, pixel by pixel over all Gaussians: slow, obvious, differentiable.

Also a scene and a camera for comparisons of renderers.
"""

from __future__ import annotations

from math import pi, sqrt

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor

from codec.camera import Camera
from codec.splats import Splats, sh_count
from player.render.project import (
    ALPHA_MAX,
    ALPHA_MIN,
    JACOBIAN_CLAMP,
    LOW_PASS_PX2,
    TRANSMITTANCE_MIN,
)


def rotations(quats: Tensor) -> Tensor:
    """(N, 3, 3) from (N, 4) wxyz of any norm."""
    w, x, y, z = torch.nn.functional.normalize(quats, dim=1).unbind(1)
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ]
    return torch.stack([torch.stack(row, 1) for row in rows], 1)


def harmonics(directions: Tensor, count: int) -> Tensor:
    """(N, count) first real spherical harmonics, normalised over the sphere, for directions (N, 3)
    of any length; those of odd order have the sign of 3D Gaussian Splatting."""
    x, y, z = torch.nn.functional.normalize(directions, dim=1).unbind(1)
    one = torch.ones_like(x)
    every = [
        sqrt(1 / (4 * pi)) * one,
        *(sqrt(3 / (4 * pi)) * axis for axis in (-y, z, -x)),
        sqrt(15 / (4 * pi)) * x * y,
        -sqrt(15 / (4 * pi)) * y * z,
        sqrt(5 / (16 * pi)) * (3 * z**2 - 1),
        -sqrt(15 / (4 * pi)) * x * z,
        sqrt(15 / (16 * pi)) * (x**2 - y**2),
        -sqrt(35 / (32 * pi)) * y * (3 * x**2 - y**2),
        sqrt(105 / (4 * pi)) * x * y * z,
        -sqrt(21 / (32 * pi)) * y * (5 * z**2 - 1),
        sqrt(7 / (16 * pi)) * z * (5 * z**2 - 3),
        -sqrt(21 / (32 * pi)) * x * (5 * z**2 - 1),
        sqrt(105 / (16 * pi)) * z * (x**2 - y**2),
        -sqrt(35 / (32 * pi)) * x * (x**2 - 3 * y**2),
    ]
    return torch.stack(every[:count], 1)


def render_reference(
    means: Tensor,
    log_scales: Tensor,
    quats: Tensor,
    logits: Tensor,
    sh: Tensor,
    camera: Camera,
    near_m: float,
) -> Tensor:
    """(H, W, 3) picture in the dtype of `means`."""
    dtype = means.dtype
    w2c = torch.tensor(camera.w2c, dtype=dtype)
    in_camera = means @ w2c[:3, :3].T + w2c[:3, 3]
    order = torch.argsort(in_camera[:, 2].detach())
    order = order[in_camera[order, 2] > near_m]
    in_camera, means = in_camera[order], means[order]
    log_scales, quats, logits, sh = log_scales[order], quats[order], logits[order], sh[order]
    x, y, z = in_camera.unbind(1)
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
    factor = rotations(quats) * log_scales.exp()[:, None, :]
    half = jacobian @ w2c[:3, :3] @ factor
    covariance = half @ half.transpose(1, 2) + LOW_PASS_PX2 * torch.eye(2, dtype=dtype)
    conic = torch.linalg.inv(covariance)
    centre = torch.stack(
        [camera.fx_px * x / z + camera.cx_px, camera.fy_px * y / z + camera.cy_px], 1
    )
    directions = means - torch.tensor(camera.position, dtype=dtype)
    colour = (0.5 + (harmonics(directions, sh.shape[1])[..., None] * sh).sum(1)).clamp(min=0)
    opacity = torch.sigmoid(logits)
    v, u = torch.meshgrid(
        torch.arange(camera.height_px, dtype=dtype) + 0.5,
        torch.arange(camera.width_px, dtype=dtype) + 0.5,
        indexing="ij",
    )
    pixels = torch.stack([u, v], -1)
    seen = torch.ones(camera.height_px, camera.width_px, dtype=dtype)
    picture = torch.zeros(camera.height_px, camera.width_px, 3, dtype=dtype)
    open_ = torch.ones_like(seen, dtype=torch.bool)
    for i in range(len(means)):
        d = pixels - centre[i]
        q = 0.5 * ((d @ conic[i]) * d).sum(-1)
        alpha = (opacity[i] * torch.exp(-q)).clamp(max=ALPHA_MAX)
        shows = (alpha >= ALPHA_MIN) & open_
        after = seen * (1 - alpha)
        ends = shows & (after < TRANSMITTANCE_MIN)
        shows = shows & ~ends
        open_ = open_ & ~ends
        weight = torch.where(shows, seen * alpha, torch.zeros_like(alpha))
        picture = picture + weight[..., None] * colour[i]
        seen = torch.where(shows, after, seen)
    return picture


def scattered_splats(count: int, seed: int, sh_degree: int = 0, logit: float = 0.5) -> Splats:
    """Gaussians around the origin, in front of `turned_camera`. logit: mean logit of opacities."""
    rng = np.random.default_rng(seed)
    return Splats(
        rng.uniform(-1.2, 1.2, (count, 3)).astype(np.float32),
        np.log(rng.uniform(0.02, 0.3, (count, 3))).astype(np.float32),
        rng.normal(size=(count, 4)).astype(np.float32),
        rng.normal(logit, 1.5, count).astype(np.float32),
        (rng.normal(size=(count, sh_count(sh_degree), 3)) * 0.6).astype(np.float32),
    )


def turned_camera(angle_rad: float = 0.4, name: str = "test") -> Camera:
    """A camera off-centre and turned, with a picture of no whole number of tiles: nothing is
    symmetric by chance, and pixels outside the picture must not count."""
    w2c = np.eye(4)
    w2c[:3, :3] = [
        [np.cos(angle_rad), 0, np.sin(angle_rad)],
        [0, 1, 0],
        [-np.sin(angle_rad), 0, np.cos(angle_rad)],
    ]
    w2c[:3, 3] = (0.1, -0.2, 2.2)
    return Camera(name, 45, 37, 40.0, 43.0, 21.0, 20.0, w2c)


def cameras_all_round(count: int) -> list[Camera]:
    """`turned_camera` at evenly spaced angles around the scene."""
    return [turned_camera(0.4 + 2 * pi * n / count, f"view{n}") for n in range(count)]


def drawn_psnr_db(
    picture: npt.NDArray[np.floating], splats: Splats, camera: Camera, most: float = np.inf
) -> float:
    """PSNR in dB of `picture` against the reference in float64, over the pixels that the reference
    draws; 1.0 is the peak. Nothing nearer than 0.2 m is drawn. most: clips the reference."""
    means, log_scales, quats, logits, sh = (torch.tensor(a).double() for a in splats.arrays)
    expected = render_reference(means, log_scales, quats, logits, sh, camera, 0.2).numpy()
    drawn = (expected > 0).any(axis=2)
    assert drawn.mean() > 0.3
    error = picture[drawn].astype(np.float64) - expected[drawn].clip(max=most)
    return float(-10 * np.log10(np.mean(error**2)))
